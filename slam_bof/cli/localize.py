"""``slam-bof localize``: the poses of depth images in a saved map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.inputs import map_file, open_sequence, read_image
from slam_bof.cli.options import (
    COMPONENT,
    DEPTH_SCALE,
    EVERY,
    FORMAT,
    FRAMES,
    INTRINSICS,
    JSON,
    MAP,
    QUIET,
    Format,
)
from slam_bof.cli.tables import show_rows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slam_bof.maps import MapLocalizer
    from slam_bof.ports import Dataset
    from slam_bof.types import DepthFrame, Trajectory

__all__ = ["localize"]

COLUMNS = (
    ("frame", "frame_index"),
    ("x m", "translation_m_0"),
    ("y m", "translation_m_1"),
    ("z m", "translation_m_2"),
    ("component", "component"),
    ("keyframe", "keyframe_id"),
    ("overlap", "overlap"),
    ("room", "room"),
    ("scene", "scene"),
    ("probability", "scene_probability"),
    ("why unknown", "reason"),
)


def localize(
    map_: MAP,
    source: Annotated[
        Path,
        typer.Argument(metavar="SEQUENCE|IMAGE", help="A sequence, or a depth image (PNG, NPY)."),
    ],
    every: EVERY = 1,
    frames: FRAMES = None,
    dataset: Annotated[
        str, typer.Option(help="Layout of a SEQUENCE; by default it is recognised.")
    ] = "auto",
    component: COMPONENT = None,
    intrinsics: INTRINSICS = None,
    depth_scale: DEPTH_SCALE = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Localize depth images in a map, each by itself.

    Prints T_map_camera, the matching keyframe, the label of the room it is in, and the scene label
    of the image, or why the pose is unknown. For a sequence with true poses, the table ends with
    the accuracy of the answers.
    """
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.datasets import first_frame, is_image
    from slam_bof.maps import MapLocalizer
    from slam_bof.slam import PluginChoice

    form: Format = "json" if as_json else format_
    localizer = MapLocalizer.open(map_file(map_), component=component)
    if is_image(source) and not source.is_dir():
        frame = read_image(source, map_, intrinsics=intrinsics, depth_scale=depth_scale)[0]
        row = _row(0, frame, localizer)
        if form == "json":
            print_json(row)
        else:
            show_rows([row], COLUMNS, form)
        return
    sequence, _ = open_sequence(source, PluginChoice(name=dataset), frames, quiet=True)
    truth, first = sequence.groundtruth(), first_frame(sequence)
    rows: list[dict[str, Any]] = []
    with Bar("Localizing", quiet=quiet or form != "table") as bar:
        for index, frame in _frames(sequence, every, rows):
            rows.append(_row(first + index, frame, localizer))
            bar.show(index + 1, len(sequence))
    show_rows(rows, COLUMNS, form)
    if form == "table":
        _summarise(rows, truth, first)


def _frames(
    sequence: Dataset, every: int, rows: list[dict[str, Any]]
) -> Iterator[tuple[int, DepthFrame]]:
    """Yield the frames; for a frame that cannot be read, add a row that says so."""
    from slam_bof.datasets import first_frame
    from slam_bof.errors import DatasetError

    for index in range(0, len(sequence), every):
        try:
            yield index, sequence.frame(index)
        except DatasetError as error:
            rows.append(
                {
                    "frame_index": first_frame(sequence) + index,
                    "is_known": False,
                    "reason": str(error),
                }
            )


def _row(index: int, frame: DepthFrame, localizer: MapLocalizer) -> dict[str, Any]:
    """Localize a frame; return the answer as a row."""
    from slam_bof.geometry import se3

    located = localizer.localize(frame)
    found, scene, T = located.localization, located.scene, located.localization.T_map_camera
    return {
        "frame_index": index,
        "stamp_s": frame.stamp_s,
        "is_known": found.is_known,
        "translation_m": None if T is None else tuple(T[:3, 3].tolist()),
        "quaternion_xyzw": None if T is None else tuple(se3.to_quaternion(T).tolist()),
        "T_map_camera": None if T is None else T.tolist(),
        "component": localizer.component if found.is_known else None,
        "keyframe_id": None if located.keyframe is None else located.keyframe.id,
        "overlap": found.overlap if found.is_known else None,
        "rmse_m": found.rmse_m if found.is_known else None,
        "room": located.room,
        "scene": None if scene is None else scene.label,
        "scene_probability": None if scene is None else scene.probability,
        "reason": found.reason,
    }


def _summarise(rows: list[dict[str, Any]], truth: Trajectory | None, first: int) -> None:
    """Print how many frames were localized and, with true poses, how accurately."""
    import numpy as np

    from slam_bof.evaluation import pose_accuracy

    known = sum(row["is_known"] for row in rows)
    typer.echo(f"{known} of {len(rows)} frames localized")
    if truth is None:
        return
    unknown = np.full((4, 4), np.nan)
    found = np.array([row.get("T_map_camera") or unknown for row in rows])
    accuracy = pose_accuracy(found, truth.poses[[row["frame_index"] - first for row in rows]])
    if accuracy is None:
        return
    shares = ", ".join(
        f"{share:.1%} within {metres:g} m and {degrees:g} degrees"
        for (metres, degrees), share in accuracy.within.items()
    )
    typer.echo(
        f"{shares} of the true poses; median error {accuracy.median_m:.3f} m, "
        f"{accuracy.median_deg:.2f} degrees (after aligning the map with the true poses)"
    )
