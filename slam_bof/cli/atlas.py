"""``slam-bof atlas``: one index over the keyframes of many maps."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.answers import pose_values, show_answer, show_answers
from slam_bof.cli.inputs import map_file, open_sequence, read_image
from slam_bof.cli.options import (
    DEPTH_SCALE,
    EVERY,
    FORMAT,
    FRAMES,
    INTRINSICS,
    JSON,
    QUIET,
    SOURCE,
    Format,
    NumbersCommand,
)

if TYPE_CHECKING:
    from slam_bof.atlas import AtlasLocalizer, AtlasMap
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
    source: SOURCE,
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
    from slam_bof.datasets import is_image
    from slam_bof.slam import PluginChoice

    form: Format = "json" if as_json else format_
    answer = partial(_answer, AtlasLocalizer(Atlas.open(atlas)))
    if is_image(source) and not source.is_dir():
        frame, _ = read_image(source, None, intrinsics=intrinsics, depth_scale=depth_scale)
        show_answer(frame, answer, COLUMNS, form)
        return
    sequence, _ = open_sequence(source, PluginChoice(name="auto"), frames, quiet=True)
    show_answers(sequence, answer, COLUMNS, form, every=every, quiet=quiet)


def _answer(localizer: AtlasLocalizer, frame: DepthFrame) -> dict[str, Any]:
    """Localize a frame; return the answer as a row."""
    found = localizer.localize(frame)
    located = found.located
    T_map_camera = None if located is None else located.localization.T_map_camera
    keyframe = None if located is None else located.keyframe
    return {
        "stamp_s": frame.stamp_s,
        "is_known": T_map_camera is not None,
        "map": None if found.map is None else found.map.path,
        **pose_values(T_map_camera),
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
    typer.echo(f"{len(maps)} map{'s' if len(maps) != 1 else ''} with {n} keyframes {what}")
