"""``slam-bof query``: keyframes, rooms and loops of a saved map; the label of a depth image."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from slam_bof.cli.inputs import map_file
from slam_bof.cli.options import (
    DEPTH_SCALE,
    FORMAT,
    INTRINSICS,
    JSON,
    Format,
    parse_numbers,
)
from slam_bof.cli.tables import show_rows
from slam_bof.errors import ConfigError

__all__ = ["query"]

KEYFRAMES = (
    ("keyframe", "id"),
    ("frame", "frame_index"),
    ("time s", "stamp_s"),
    ("scene", "label"),
    ("probability", "label_probability"),
    ("scene of image", "scene"),
    ("probability", "scene_probability"),
    ("room", "region"),
    ("x m", "translation_m_0"),
    ("y m", "translation_m_1"),
    ("z m", "translation_m_2"),
    ("loops", "n_loops"),
)
LOOPS = (
    ("query", "query_id"),
    ("match", "match_id"),
    ("query time s", "query_stamp_s"),
    ("match time s", "match_stamp_s"),
    ("found by", "source"),
)
ROOMS = (
    ("room", "id"),
    ("scene", "label"),
    ("probability", "probability"),
    ("keyframes", "n_keyframes"),
    ("x m", "center_m_0"),
    ("y m", "center_m_1"),
    ("z m", "center_m_2"),
    ("size x m", "size_m_0"),
    ("size y m", "size_m_1"),
    ("size z m", "size_m_2"),
)


def query(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="MAP|IMAGE",
            help="A map.db, the folder of a run, or (with --model) a depth image.",
        ),
    ],
    keyframe: Annotated[int | None, typer.Option(min=0, help="Only this keyframe.")] = None,
    time: Annotated[
        float | None, typer.Option(metavar="S", help="Order by time difference to S.")
    ] = None,
    near: Annotated[
        str | None,
        typer.Option(metavar="X Y Z", help="Order by distance to this position (m, map frame)."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="Only keyframes with this label; rooms with it are printed too."),
    ] = None,
    min_probability: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Only labels at least this probable."),
    ] = 0.0,
    labels: Annotated[
        Literal["smoothed", "raw"],
        typer.Option(help="Labels smoothed over neighbours, or those of single images."),
    ] = "smoothed",
    limit: Annotated[int | None, typer.Option(min=1, help="Print at most this many.")] = None,
    rooms: Annotated[
        bool, typer.Option("--rooms", "--regions", help="Print rooms instead.")
    ] = False,
    loops: Annotated[bool, typer.Option("--loops", help="Print loops instead.")] = False,
    model: Annotated[
        str | None, typer.Option(help="For an IMAGE: the model file, default or synthetic.")
    ] = None,
    intrinsics: INTRINSICS = None,
    depth_scale: DEPTH_SCALE = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
) -> None:
    """Print keyframes, rooms or loops of a saved map, with poses and scene labels.

    For a single depth image, print the scene label that a model gives it.
    """
    from slam_bof.datasets import is_image

    form: Format = "json" if as_json else format_
    if is_image(path) and not path.is_dir():
        of_map = {"--time": time, "--keyframe": keyframe, "--near": near, "--scene": scene}
        _refuse([name for name, value in of_map.items() if value is not None], "a map")
        _label_image(path, model, intrinsics, depth_scale, min_probability, form)
        return
    of_image = {"--model": model, "--intrinsics": intrinsics, "--depth-scale": depth_scale}
    _refuse([name for name, value in of_image.items() if value is not None], "a depth image")
    from slam_bof.store import MapStore, query_keyframes, query_loops, query_rooms

    with MapStore.open(map_file(path)) as store:
        if loops:
            show_rows(
                [asdict(r) for r in query_loops(store, keyframe_id=keyframe)[:limit]], LOOPS, form
            )
            return
        if rooms:
            found = query_rooms(store, scene=scene, min_probability=min_probability)
            show_rows([_room(room) for room in found[:limit]], ROOMS, form)
            return
        records = query_keyframes(
            store,
            keyframe_id=keyframe,
            time_s=time,
            near_m=None if near is None else parse_numbers("--near", near, "X Y Z in metres"),
            scene=scene,
            min_probability=min_probability,
            labels=labels,
            limit=limit,
        )
        if scene is not None and form == "table":
            with_scene = [_room(r) for r in query_rooms(store, scene=scene)]
            show_rows(with_scene, ROOMS, form, "Rooms (extent of the camera positions)")
    rows = [asdict(record) for record in records]
    if form == "table":
        rows = [{**row, **_label(row)} for row in rows]
    show_rows(rows, KEYFRAMES, form)


def _label_image(
    path: Path,
    model: str | None,
    intrinsics: str | None,
    depth_scale: float | None,
    min_probability: float,
    form: Format,
) -> None:
    from slam_bof.cli.console import print_json
    from slam_bof.scenes import label_image, model as models

    numbers = None
    if intrinsics is not None:
        numbers = parse_numbers("--intrinsics", intrinsics, "FX FY CX CY in pixels")
    answer = label_image(
        path,
        models.resolve(model),
        intrinsics=numbers,
        depth_scale=depth_scale,
        min_probability=min_probability,
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


def _label(row: dict[str, Any]) -> dict[str, Any]:
    """Return the smoothed label of a keyframe; where there is none, that of its image."""
    name = "scene" if row["smoothed"] is None else "smoothed"
    return {"label": row[name], "label_probability": row[f"{name}_probability"]}


def _room(room: Any) -> dict[str, Any]:
    size_m = tuple(b - a for a, b in zip(room.low_m, room.high_m, strict=True))
    return {**asdict(room), "size_m": size_m, "n_keyframes": len(room.keyframe_ids)}


def _refuse(options: list[str], what: str) -> None:
    if options:
        raise ConfigError(f"{', '.join(options)}: found without {what}, expected for {what} only")
