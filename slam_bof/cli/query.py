"""``slam-bof query``: what a saved map says, or a model of a single depth image."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slam_bof.cli.options import JSON
from slam_bof.cli.tables import parse_numbers, show_rows
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    pass

__all__ = ["map_file", "query"]

KEYFRAMES = (
    ("keyframe", "id"),
    ("frame", "frame_index"),
    ("time s", "stamp_s"),
    ("scene", "label"),
    ("probability", "label_probability"),
    ("by itself", "scene"),
    ("probability", "scene_probability"),
    ("region", "region"),
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
REGIONS = (
    ("region", "id"),
    ("scene", "label"),
    ("probability", "probability"),
    ("keyframes", "n_keyframes"),
    ("x m", "center_m_0"),
    ("y m", "center_m_1"),
    ("z m", "center_m_2"),
    ("wide m", "size_m_0"),
    ("high m", "size_m_1"),
    ("deep m", "size_m_2"),
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
        float | None, typer.Option(metavar="S", help="Nearest to this time (s) first.")
    ] = None,
    near: Annotated[
        str | None,
        typer.Option(metavar="X Y Z", help="Nearest to this position (m, map frame) first."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="Only with this scene label; the table also says where such rooms are."),
    ] = None,
    min_probability: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Only with a label at least this probable.")
    ] = 0.0,
    labels: Annotated[
        Literal["smoothed", "raw"],
        typer.Option(help="Labels by the whole trajectory, or of each keyframe by itself."),
    ] = "smoothed",
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many.")] = None,
    regions: Annotated[bool, typer.Option("--regions", help="Rooms instead of keyframes.")] = False,
    loops: Annotated[bool, typer.Option("--loops", help="Loops instead of keyframes.")] = False,
    model: Annotated[
        str | None, typer.Option(help="Of an IMAGE: the model file, or default.")
    ] = None,
    intrinsics: Annotated[
        str | None,
        typer.Option(
            metavar="FX FY CX CY",
            help="Of an IMAGE: focal lengths and principal point (px); by default those of "
            "intrinsics.json beside it, or else a Kinect's, which is said.",
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
) -> None:
    """Ask a saved map where its keyframes and rooms are, what they show, which loops there are.

    Of a depth image by itself, a model says which scene it shows.
    """
    from slam_bof.datasets import is_image

    form = "json" if as_json else format_
    if is_image(path) and not path.is_dir():
        asked = {"--time": time, "--keyframe": keyframe, "--near": near, "--scene": scene}
        _refuse([name for name, value in asked.items() if value is not None], "a map")
        _ask_image(path, model or "default", intrinsics, depth_scale, min_probability, form)
        return
    of_image = {"--model": model, "--intrinsics": intrinsics, "--depth-scale": depth_scale}
    _refuse([name for name, value in of_image.items() if value is not None], "a depth image")
    from slam_bof.store import MapStore, query_keyframes, query_loops, query_regions

    with MapStore.open(map_file(path)) as store:
        if loops:
            show_rows(
                [asdict(r) for r in query_loops(store, keyframe_id=keyframe)[:limit]], LOOPS, form
            )
            return
        if regions:
            found = query_regions(store, scene=scene, min_probability=min_probability)
            show_rows([_region(region) for region in found[:limit]], REGIONS, form)
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
            rooms = [_region(r) for r in query_regions(store, scene=scene)]
            show_rows(rooms, REGIONS, form, "Rooms, by where the camera was in them")
    rows = [asdict(record) for record in records]
    if form == "table":
        rows = [{**row, **_label(row)} for row in rows]
    show_rows(rows, KEYFRAMES, form)


def map_file(path: Path) -> Path:
    """Return the map.db that was meant."""
    return path / "map.db" if path.is_dir() else path


def _ask_image(
    path: Path,
    model: str,
    intrinsics: str | None,
    depth_scale: float | None,
    min_probability: float,
    form: str,
) -> None:
    from slam_bof.scenes import label_image, model as models

    numbers = None
    if intrinsics is not None:
        numbers = parse_numbers("--intrinsics", intrinsics, "FX FY CX CY in pixels")
    answer = label_image(
        path,
        models.load_default() if model == "default" else models.load(model),
        intrinsics=numbers,
        depth_scale=depth_scale,
        min_probability=min_probability,
    )
    if form == "json":
        show_rows([asdict(answer)], (), "json", single=True)
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
    """Return the smoothed label of a keyframe; of one without, its own."""
    name = "scene" if row["smoothed"] is None else "smoothed"
    return {"label": row[name], "label_probability": row[f"{name}_probability"]}


def _region(region: Any) -> dict[str, Any]:
    size_m = tuple(b - a for a, b in zip(region.low_m, region.high_m, strict=True))
    ids = region.keyframe_ids
    return {**asdict(region), "size_m": size_m, "n_keyframes": len(ids)}


def _refuse(options: list[str], what: str) -> None:
    if options:
        raise ConfigError(f"{', '.join(options)}: found without {what}, expected for {what} only")
