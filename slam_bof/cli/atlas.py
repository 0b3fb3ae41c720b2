"""``slam-bof atlas``: one index over the keyframes of many maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.inputs import map_file, open_sequence, read_image
from slam_bof.cli.options import (
    DEPTH_SCALE,
    EVERY,
    FORMAT,
    FRAMES,
    INTRINSICS,
    JSON,
    QUIET,
    Format,
    NumbersCommand,
)

if TYPE_CHECKING:
    from slam_bof.atlas import AtlasLocalization, AtlasMap
    from slam_bof.types import DepthFrame

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="Localize in many maps at once.")

ATLAS = Annotated[Path, typer.Argument(metavar="ATLAS", help="The folder of an atlas.")]
MAPS = Annotated[
    list[Path], typer.Argument(metavar="MAP...", help="Maps: map.db files, or folders of runs.")
]
COLUMNS = (
    ("frame", "frame_index"),
    ("map", "map"),
    ("x m", "translation_m_0"),
    ("y m", "translation_m_1"),
    ("z m", "translation_m_2"),
    ("keyframe", "keyframe_id"),
    ("room", "room"),
    ("why unknown", "reason"),
)


@app.command()
def add(atlas: ATLAS, maps: MAPS, as_json: JSON = False) -> None:
    """Add finished maps to an atlas, or make one. A map that it has is described again."""
    from slam_bof.atlas import Atlas

    _print(Atlas.add(atlas, map(map_file, maps)), "added", as_json=as_json)


@app.command(name="list")
def list_(atlas: ATLAS, as_json: JSON = False) -> None:
    """List the maps of an atlas."""
    from slam_bof.atlas import Atlas

    _print(list(Atlas.open(atlas).maps), "in the atlas", as_json=as_json)


@app.command()
def remove(atlas: ATLAS, maps: MAPS, as_json: JSON = False) -> None:
    """Remove maps from an atlas. The maps themselves stay."""
    from slam_bof.atlas import Atlas

    _print(Atlas.remove(atlas, map(map_file, maps)), "removed", as_json=as_json)


@app.command(cls=NumbersCommand)
def localize(
    atlas: ATLAS,
    source: Annotated[
        Path,
        typer.Argument(metavar="SEQUENCE|IMAGE", help="A sequence, or a depth image (PNG, NPY)."),
    ],
    every: EVERY = 1,
    frames: FRAMES = None,
    intrinsics: INTRINSICS = None,
    depth_scale: DEPTH_SCALE = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Localize depth images in all maps of an atlas, each by itself.

    Prints the map, T_map_camera, the matching keyframe and its room, or why they are unknown.
    """
    from slam_bof.atlas import Atlas, AtlasLocalizer
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.cli.tables import show_rows
    from slam_bof.datasets import first_frame, is_image
    from slam_bof.slam import PluginChoice

    form: Format = "json" if as_json else format_
    localizer = AtlasLocalizer(Atlas.open(atlas))
    if is_image(source) and not source.is_dir():
        frame, _ = read_image(source, None, intrinsics=intrinsics, depth_scale=depth_scale)
        row = _row(0, frame, localizer.localize(frame))
        if form == "json":
            print_json(row)
        else:
            show_rows([row], COLUMNS, form)
        return
    sequence, _ = open_sequence(source, PluginChoice(name="auto"), frames, quiet=True)
    rows, first = [], first_frame(sequence)
    with Bar("Localizing", quiet=quiet or form != "table") as bar:
        for index in range(0, len(sequence), every):
            frame = sequence.frame(index)
            rows.append(_row(first + index, frame, localizer.localize(frame)))
            bar.show(index + 1, len(sequence))
    show_rows(rows, COLUMNS, form)
    if form == "table":
        known = sum(row["is_known"] for row in rows)
        typer.echo(f"{known} of {len(rows)} frames localized")


def _row(index: int, frame: DepthFrame, found: AtlasLocalization) -> dict[str, Any]:
    """Return the answer for a frame as a row."""
    from slam_bof.geometry import se3

    located = found.located
    T = None if located is None else located.localization.T_map_camera
    keyframe = None if located is None else located.keyframe
    return {
        "frame_index": index,
        "stamp_s": frame.stamp_s,
        "is_known": T is not None,
        "map": None if found.map is None else found.map.path,
        "translation_m": None if T is None else tuple(T[:3, 3].tolist()),
        "quaternion_xyzw": None if T is None else tuple(se3.to_quaternion(T).tolist()),
        "T_map_camera": None if T is None else T.tolist(),
        "keyframe_id": None if keyframe is None else keyframe.id,
        "room": None if located is None else located.room,
        "reason": found.reason,
    }


def _print(maps: list[AtlasMap], what: str, *, as_json: bool) -> None:
    from slam_bof.cli.console import print_json, print_table

    rows = [{"map": entry.path, "n_keyframes": entry.n_keyframes} for entry in maps]
    if as_json:
        print_json({"maps": rows})
        return
    if rows:
        print_table(("map", "keyframes"), [list(row.values()) for row in rows])
    n = sum(entry.n_keyframes for entry in maps)
    typer.echo(f"{len(maps)} maps with {n} keyframes {what}")
