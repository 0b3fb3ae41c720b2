"""Commands about what a run has left: ``query``, ``report`` and ``export``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slam_bof.cli.options import JSON, MAP
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    from slam_bof.queries import KeyframeRecord
    from slam_bof.store import MapStore

__all__ = ["export", "query", "report"]


def query(
    map_: MAP,
    keyframe: Annotated[int | None, typer.Option(min=0, help="Only this keyframe.")] = None,
    time: Annotated[
        float | None, typer.Option(metavar="S", help="Nearest to this time first.")
    ] = None,
    near: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Nearest to this position (m) first.")
    ] = None,
    scene: Annotated[str | None, typer.Option(help="Only with this scene label.")] = None,
    min_probability: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Of the scene label asked for.")
    ] = 0.0,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many.")] = None,
    loops: Annotated[bool, typer.Option("--loops", help="Loops instead of keyframes.")] = False,
    as_json: JSON = False,
) -> None:
    """Ask a saved map where its keyframes are, which scenes they show, which loops they close."""
    from slam_bof.cli.console import print_json, print_table
    from slam_bof.queries import query_keyframes, query_loops
    from slam_bof.store import MapStore

    with MapStore.open(_map_file(map_)) as store:
        if loops:
            found_loops = query_loops(store, keyframe_id=keyframe)[:limit]
            if as_json:
                print_json([asdict(loop) for loop in found_loops])
            else:
                rows = [
                    (r.query_id, r.match_id, r.query_stamp_s, r.match_stamp_s, r.source)
                    for r in found_loops
                ]
                print_table(("query", "match", "query time s", "match time s", "found by"), rows)
            return
        found = query_keyframes(
            store,
            keyframe_id=keyframe,
            time_s=time,
            near_m=_position(near),
            scene=scene,
            min_probability=min_probability,
            limit=limit,
        )
    if as_json:
        print_json([asdict(record) for record in found])
        return
    print_table(
        ("keyframe", "frame", "time s", "scene", "probability", "x m", "y m", "z m", "loops"),
        [(*_labels(r), *r.translation_m, r.n_loops) for r in found],
    )


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The page; by default the run's own.")
    ] = None,
    as_json: JSON = False,
) -> None:
    """Write the page of a run again, from the files that it left."""
    from slam_bof.cli.console import print_json
    from slam_bof.report import write_report
    from slam_bof.runs import read_run

    page = out or run / "report.html"
    write_report(page, read_run(run))
    if as_json:
        print_json({"report": str(page)})
    else:
        typer.echo(f"Report: {page}")


def export(
    map_: MAP,
    out: Annotated[Path, typer.Option("--out", "-o", help="The file to write.")],
    format_: Annotated[
        Literal["tum", "kitti", "csv"],
        typer.Option("--format", help="Keyframe poses (tum, kitti), or with labels (csv)."),
    ] = "tum",
    as_json: JSON = False,
) -> None:
    """Write a map's keyframes, at their poses in the map, into a file for other programs."""
    from slam_bof.cli.console import print_json
    from slam_bof.store import MapStore

    with MapStore.open(_map_file(map_)) as store:
        n_keyframes = _write(store, out, format_)
    if as_json:
        print_json({"file": str(out), "format": format_, "n_keyframes": n_keyframes})
    else:
        typer.echo(f"{n_keyframes} keyframes: {out}")


def _write(store: MapStore, out: Path, format_: str) -> int:
    import csv

    import numpy as np

    from slam_bof.queries import query_keyframes
    from slam_bof.trajectory import write_kitti, write_tum
    from slam_bof.types import Trajectory

    if format_ == "csv":
        records = query_keyframes(store)
        with out.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            names = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
            table.writerow(("id", "frame_index", "stamp_s", "scene", "probability", *names))
            for r in records:
                table.writerow((*_labels(r), *r.translation_m, *r.quaternion_xyzw))
        return len(records)
    poses = store.map_poses()
    stamps_s = np.array([keyframe.stamp_s for keyframe in store.keyframes()])
    known = np.isfinite(poses).all(axis=(1, 2))
    trajectory = Trajectory(stamps_s[known], poses[known])
    (write_tum if format_ == "tum" else write_kitti)(out, trajectory)
    return len(trajectory)


def _labels(r: KeyframeRecord) -> tuple[object, ...]:
    return r.id, r.frame_index, r.stamp_s, r.scene, r.scene_probability


def _map_file(path: Path) -> Path:
    """Return the map.db that was meant."""
    return path / "map.db" if path.is_dir() else path


def _position(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3:
        raise ConfigError(f"--near: found {text!r}, expected X,Y,Z in metres, such as 0.5,0,2")
    return values
