"""``slam-bof localize``: where in a saved map depth images were taken."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slam_bof.cli.options import FRAMES, JSON, MAP, QUIET
from slam_bof.cli.query import map_file
from slam_bof.cli.tables import parse_numbers, show_rows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slam_bof.maps import Located
    from slam_bof.types import DepthFrame, Intrinsics, Trajectory

__all__ = ["localize"]

COLUMNS = (
    ("frame", "frame_index"),
    ("x m", "translation_m_0"),
    ("y m", "translation_m_1"),
    ("z m", "translation_m_2"),
    ("keyframe", "keyframe_id"),
    ("overlap", "overlap"),
    ("room", "room"),
    ("scene", "scene"),
    ("probability", "scene_probability"),
    ("not known, for", "reason"),
)


def localize(
    map_: MAP,
    source: Annotated[
        Path,
        typer.Argument(metavar="SEQUENCE|IMAGE", help="A sequence, or a depth image (PNG, NPY)."),
    ],
    every: Annotated[int, typer.Option(min=1, help="Only each so many frames.")] = 1,
    frames: FRAMES = None,
    dataset: Annotated[
        str, typer.Option(help="Layout of a SEQUENCE, as slam-bof plugins lists them.")
    ] = "auto",
    intrinsics: Annotated[
        str | None,
        typer.Option(
            metavar="FX FY CX CY",
            help="Of an IMAGE: focal lengths and principal point (px); by default the map's.",
        ),
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(min=1.0, help="Of an IMAGE: units a metre; by default 1000 (mm)."),
    ] = None,
    format_: Annotated[
        Literal["table", "json", "csv"], typer.Option("--format", help="How to print.")
    ] = "table",
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Say where in a map depth images were taken, each by itself, or that it is not known.

    T_map_camera, the keyframe that matches, the room that it is in, and the scene that the image
    shows. Of a sequence with true poses, the table also says how exact the answers are.
    """
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.datasets import is_image
    from slam_bof.maps import MapLocalizer

    form = "json" if as_json else format_
    places = MapLocalizer.open(map_file(map_))
    if is_image(source) and not source.is_dir():
        frame = _read(source, places.intrinsics, intrinsics, depth_scale)
        row = _row(0, frame, places.localize(frame))
        if form == "json":
            print_json(row)
        else:
            show_rows([row], COLUMNS, form)
        return
    sequence, truth = _open(source, dataset, frames)
    rows: list[dict[str, Any]] = []
    with Bar("Localizing", quiet=quiet or form != "table") as bar:
        for index, frame in _frames(sequence, every, rows):
            rows.append(_row(index, frame, places.localize(frame)))
            bar.show(index + 1, len(sequence))
    show_rows(rows, COLUMNS, form)
    if form == "table":
        _summarise(rows, truth)


def _read(
    path: Path, camera: Intrinsics, intrinsics: str | None, depth_scale: float | None
) -> DepthFrame:
    """Read a depth image; where nothing says which camera it is of, it is the map's."""
    from slam_bof.datasets import read_depth_image

    given = [camera.fx, camera.fy, camera.cx, camera.cy]
    if intrinsics is not None:
        given = parse_numbers("--intrinsics", intrinsics, "FX FY CX CY in pixels")
    elif (path.parent / "intrinsics.json").is_file():
        given = []
    return read_depth_image(path, intrinsics=given or None, depth_scale=depth_scale)[0]


def _open(path: Path, dataset: str, frames: str | None) -> tuple[Any, Trajectory | None]:
    """Open a sequence; return it and its true poses, if there are any."""
    from slam_bof.core import registry
    from slam_bof.datasets import Excerpt

    sequence = registry.open_dataset(path, dataset)
    if frames is not None:
        sequence = Excerpt.parse(sequence, frames)
    return sequence, sequence.groundtruth()


def _frames(
    sequence: Any, every: int, rows: list[dict[str, Any]]
) -> Iterator[tuple[int, DepthFrame]]:
    """Yield the frames; of one that cannot be read, a row says so."""
    from slam_bof.errors import DatasetError

    for index in range(0, len(sequence), every):
        try:
            yield index, sequence.frame(index)
        except DatasetError as error:
            rows.append({"frame_index": index, "is_known": False, "reason": str(error)})


def _row(index: int, frame: DepthFrame, located: Located) -> dict[str, Any]:
    """Return what is known of a frame, flat but for its poses."""
    from slam_bof.geometry import se3

    found, scene, T = located.found, located.scene, located.found.T_map_camera
    return {
        "frame_index": index,
        "stamp_s": frame.stamp_s,
        "is_known": found.is_known,
        "translation_m": None if T is None else tuple(T[:3, 3].tolist()),
        "quaternion_xyzw": None if T is None else tuple(se3.to_quaternion(T).tolist()),
        "T_map_camera": None if T is None else T.tolist(),
        "keyframe_id": None if located.keyframe is None else located.keyframe.id,
        "overlap": found.overlap if found.is_known else None,
        "rmse_m": found.rmse_m if found.is_known else None,
        "room": located.room,
        "scene": None if scene is None else scene.label,
        "scene_probability": None if scene is None else scene.probability,
        "reason": found.reason,
    }


def _summarise(rows: list[dict[str, Any]], truth: Trajectory | None) -> None:
    """Print how many frames are known and, by the true poses, how exactly."""
    import numpy as np

    from slam_bof.evaluation import pose_accuracy

    known = sum(row["is_known"] for row in rows)
    typer.echo(f"{known} of {len(rows)} frames localized")
    if truth is None:
        return
    unknown = np.full((4, 4), np.nan)
    found = np.array([row.get("T_map_camera") or unknown for row in rows])
    accuracy = pose_accuracy(found, truth.poses[[row["frame_index"] for row in rows]])
    if accuracy is None:
        return
    shares = ", ".join(
        f"{share:.1%} within {metres:g} m and {degrees:g} degrees"
        for (metres, degrees), share in accuracy.within.items()
    )
    typer.echo(
        f"of these {shares} of the true poses; median {accuracy.median_m:.3f} m, "
        f"{accuracy.median_deg:.2f} degrees (the map aligned as most answers have it)"
    )
