"""``slam-bof query``: keyframes, rooms and loops of a saved map; the label of a depth image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from slam_bof.cli.inputs import map_file, read_image
from slam_bof.cli.one_line import one_line
from slam_bof.cli.options import (
    COMPONENT,
    DEPTH_SCALE,
    FORMAT,
    INTRINSICS,
    JSON,
    MAP,
    Format,
    NumbersCommand,
    finite,
    parse_numbers,
)
from slam_bof.cli.tables import show_rows

if TYPE_CHECKING:
    from slam_bof.scenes import MapRoom
    from slam_bof.store import MapStore

__all__ = ["app"]

LabelledBy = Literal["levelled", "bag", "constellation"]
KEYFRAMES = (
    ("keyframe", "id"),
    ("frame", "frame_index"),
    ("time s", "stamp_s"),
    ("smoothed", "smoothed"),
    ("probability", "smoothed_probability"),
    ("scene", "scene"),
    ("probability", "scene_probability"),
    ("room", "region"),
    ("x m", "translation_m_0"),
    ("y m", "translation_m_1"),
    ("z m", "translation_m_2"),
    ("loops", "n_loops"),
    ("component", "component"),
)
APART, DISTANCE = ("apart s", "apart_s"), ("distance m", "distance_m")
SIGMAS = (("sigma m", "sigma_m"), ("sigma degrees", "sigma_degrees"))
LOOPS = (
    ("query", "query_id"),
    ("match", "match_id"),
    ("query time s", "query_stamp_s"),
    ("match time s", "match_stamp_s"),
    ("found by", "source"),
    ("overlap", "overlap"),
    ("decision", "decision"),
    ("reason", "reason"),
    ("component", "component"),
)
OUTSIDE_S = 1.0
"""Seconds before the first and after the last keyframe for which these are taken as the answer."""
ROOMS = (
    ("room", "id"),
    ("label", "label"),
    ("probability", "probability"),
    ("keyframes", "n_keyframes"),
    ("x m", "center_m_0"),
    ("y m", "center_m_1"),
    ("z m", "center_m_2"),
    ("size x m", "size_m_0"),
    ("size y m", "size_m_1"),
    ("size z m", "size_m_2"),
    ("component", "component"),
)


class QueryGroup(TyperGroup):
    """Subcommands, of which the plain forms ``query MAP`` and ``query IMAGE`` need no name."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the subcommand in front where there is none."""
        if args and args[0] not in self.commands and args != ["--help"] and args != ["-h"]:
            args = _name_command(args)
        return super().parse_args(ctx, args)


def _name_command(args: list[str]) -> list[str]:
    from slam_bof.datasets import is_image

    for option, command in (("--loops", "loops"), ("--rooms", "rooms"), ("--regions", "rooms")):
        if option in args:
            return [command, *(arg for arg in args if arg != option)]
    paths = [Path(arg) for arg in args if not arg.startswith("-")]
    shows_image = any(is_image(path) and not path.is_dir() for path in paths)
    return ["image" if shows_image else "keyframes", *args]


app = typer.Typer(
    cls=QueryGroup,
    no_args_is_help=True,
    help="Print keyframes, rooms or loops of a saved map, or the scene of a depth image.",
)

SCENE = Annotated[str | None, typer.Option(help="Only what has this label.")]
MIN_PROBABILITY = Annotated[
    float,
    typer.Option(min=0.0, max=1.0, callback=finite, help="Only labels at least this probable."),
]
LIMIT = Annotated[int | None, typer.Option(min=1, help="Print at most this many.")]
KEYFRAME = Annotated[int | None, typer.Option(min=0, help="Only this keyframe.")]


@app.command(cls=NumbersCommand)
def keyframes(
    map_: MAP,
    keyframe: KEYFRAME = None,
    time: Annotated[
        float | None,
        typer.Option(callback=finite, metavar="S", help="Order by time difference to S."),
    ] = None,
    near: Annotated[
        str | None,
        typer.Option(metavar="X Y Z", help="Order by distance to this position (m, map frame)."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="Only keyframes with this label; rooms with it are printed too."),
    ] = None,
    min_probability: MIN_PROBABILITY = 0.0,
    labels: Annotated[
        Literal["smoothed", "raw"],
        typer.Option(help="Labels smoothed over neighbours, or those of single images."),
    ] = "smoothed",
    component: COMPONENT = None,
    uncertainty: Annotated[
        bool,
        typer.Option(
            "--uncertainty",
            help="Print the standard deviations of position and direction too, relative to the "
            "first keyframe of the component.",
        ),
    ] = False,
    limit: LIMIT = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
) -> None:
    """Print the keyframes of a saved map, with poses and scene labels."""
    from slam_bof.store import MapStore, query_keyframes, query_rooms

    if time is not None and near is not None:
        raise typer.BadParameter("found both --time and --near, expected one order")
    form: Format = "json" if as_json else format_
    with MapStore.open(map_file(map_)) as store, store.snapshot():
        records = query_keyframes(
            store,
            keyframe_id=keyframe,
            time_s=time,
            near_m=None if near is None else parse_numbers("--near", near, "X Y Z in metres"),
            scene=scene,
            min_probability=min_probability,
            labels=labels,
            component=component,
            limit=limit,
        )
        if scene is not None and form == "table":
            with_scene = _rooms(store, query_rooms(store, scene=scene))
            show_rows(with_scene, ROOMS, form, "Rooms (extent of the camera positions)")
        rows = [asdict(record) for record in records]
        if uncertainty:
            rows = _with_sigmas(rows, store)
        _remark_on_time(store, time)
        if scene is not None and not rows:
            _remark_on_scene(store, scene, labels)
    asked = () if time is None else (APART,)
    asked = (DISTANCE,) if near is not None else asked
    show_rows(rows, (*KEYFRAMES, *asked, *(SIGMAS if uncertainty else ())), form)


def _remark_on_time(store: MapStore, time_s: float | None) -> None:
    """Say that a time lies outside of what the map holds, if so."""
    from slam_bof.store import query_keyframes

    if time_s is None:
        return
    stamps_s = [record.stamp_s for record in query_keyframes(store)]
    if stamps_s and not min(stamps_s) - OUTSIDE_S <= time_s <= max(stamps_s) + OUTSIDE_S:
        typer.echo(
            f"warning: no keyframe was near {time_s:.12g} s: those of the map have times from "
            f"{min(stamps_s):.3f} to {max(stamps_s):.3f} s",
            err=True,
        )


def _remark_on_scene(store: MapStore, scene: str, labels: Literal["smoothed", "raw"]) -> None:
    """Say which labels there are instead of one that no keyframe has."""
    from collections import Counter

    from slam_bof.store import query_keyframes

    found = [
        record.scene if labels == "raw" or record.smoothed is None else record.smoothed
        for record in query_keyframes(store)
    ]
    if scene in found:
        return  # another condition excludes it
    counts = ", ".join(f"{name} {n}" for name, n in Counter(found).most_common() if name)
    other = "; --labels raw counts each keyframe by itself" if labels == "smoothed" else ""
    text = f"no keyframe has the {labels} label {scene}; there are: {counts or 'none'}{other}"
    typer.echo(one_line(f"warning: {text}"), err=True)


def _with_sigmas(rows: list[dict[str, Any]], store: MapStore) -> list[dict[str, Any]]:
    """Return rows of keyframes with the standard deviations of their poses, None if unknown."""
    import numpy as np

    from slam_bof.maps import pose_covariances

    variances = np.diagonal(pose_covariances(store), axis1=1, axis2=2)
    turned, moved = np.sqrt(variances.reshape(-1, 2, 3).sum(axis=2)).T
    known = np.isfinite(moved)
    return [
        row
        | {
            "sigma_m": float(moved[row["id"]]) if known[row["id"]] else None,
            "sigma_degrees": float(np.degrees(turned[row["id"]])) if known[row["id"]] else None,
        }
        for row in rows
    ]


@app.command()
def rooms(
    map_: MAP,
    scene: SCENE = None,
    min_probability: MIN_PROBABILITY = 0.0,
    limit: LIMIT = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
) -> None:
    """Print the rooms of a saved map: their labels and extents."""
    from slam_bof.store import MapStore, query_rooms

    with MapStore.open(map_file(map_)) as store, store.snapshot():
        found = query_rooms(store, scene=scene, min_probability=min_probability)
        rows = _rooms(store, found[:limit])
    show_rows(rows, ROOMS, "json" if as_json else format_)


@app.command()
def loops(
    map_: MAP,
    keyframe: KEYFRAME = None,
    accepted: Annotated[bool, typer.Option("--accepted", help="Only loops of the graph.")] = False,
    rejected: Annotated[
        bool, typer.Option("--rejected", help="Only pairs that were rejected or held.")
    ] = False,
    limit: LIMIT = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
) -> None:
    """Print the pairs that were considered as loops, the decisions, and why."""
    from slam_bof.store import MapStore, query_loops

    if accepted and rejected:
        raise typer.BadParameter("found both --accepted and --rejected, expected one of them")
    with MapStore.open(map_file(map_)) as store, store.snapshot():
        found = query_loops(store, keyframe_id=keyframe, considered=not accepted)
    if rejected:
        found = [record for record in found if record.decision != "accepted"]
    show_rows([asdict(record) for record in found[:limit]], LOOPS, "json" if as_json else format_)


@app.command(cls=NumbersCommand)
def image(
    path: Annotated[Path, typer.Argument(metavar="IMAGE", help="A depth image.")],
    model: Annotated[str, typer.Option(help="The model file, default or synthetic.")] = "default",
    map_: Annotated[
        Path | None,
        typer.Option("--map", metavar="MAP", help="Take camera and unit of depth from this map."),
    ] = None,
    intrinsics: INTRINSICS = None,
    depth_scale: DEPTH_SCALE = None,
    min_probability: MIN_PROBABILITY = 0.0,
    by: Annotated[
        LabelledBy,
        typer.Option(help="Classifier of the model that labels the image; see labels.by."),
    ] = "levelled",
    format_: FORMAT = "table",
    as_json: JSON = False,
) -> None:
    """Print the scene label that a model gives a single depth image."""
    from slam_bof.cli.console import print_json
    from slam_bof.scenes import label_frame, model as models

    form: Format = "json" if as_json else format_
    chosen = models.resolve(model)
    frame, source = read_image(path, map_, intrinsics=intrinsics, depth_scale=depth_scale)
    answer = label_frame(
        frame, chosen, name=str(path), source=source, min_probability=min_probability, by=by
    )
    if form == "json":
        print_json(asdict(answer))
        return
    if form == "table":
        camera = answer.intrinsics
        typer.echo(
            f"{path}: {answer.label}, probability {answer.probability:.3f} "
            f"(intrinsics {camera.fx:g} {camera.fy:g} {camera.cx:g} {camera.cy:g}: "
            f"{answer.intrinsics_from})"
        )
    rows = [{"scene": name, "probability": p} for name, p in answer.probabilities.items()]
    show_rows(rows, (("scene", "scene"), ("probability", "probability")), form)


def _rooms(store: MapStore, found: Sequence[MapRoom]) -> list[dict[str, Any]]:
    from slam_bof.store import components_of

    components = components_of(store)
    return [
        {
            **asdict(room),
            "size_m": tuple(b - a for a, b in zip(room.low_m, room.high_m, strict=True)),
            "n_keyframes": len(room.keyframe_ids),
            "component": int(components[room.keyframe_ids[0]]),
        }
        for room in found
    ]
