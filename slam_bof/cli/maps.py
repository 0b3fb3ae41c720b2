"""Commands that write what a run has left: ``report`` and ``export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slam_bof.cli.options import JSON, MAP
from slam_bof.cli.querying import map_file

if TYPE_CHECKING:
    from slam_bof.store import MapStore

__all__ = ["export", "report"]


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

    with MapStore.open(map_file(map_)) as store:
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
            smoothed = ("smoothed", "smoothed_probability", "region")
            own = ("id", "frame_index", "stamp_s", "scene", "probability")
            table.writerow((*own, *names, *smoothed))
            for r in records:
                own_label = (r.id, r.frame_index, r.stamp_s, r.scene, r.scene_probability)
                around = (r.smoothed, r.smoothed_probability, r.region)
                table.writerow((*own_label, *r.translation_m, *r.quaternion_xyzw, *around))
        return len(records)
    poses = store.map_poses()
    stamps_s = np.array([keyframe.stamp_s for keyframe in store.keyframes()])
    known = np.isfinite(poses).all(axis=(1, 2))
    trajectory = Trajectory(stamps_s[known], poses[known])
    (write_tum if format_ == "tum" else write_kitti)(out, trajectory)
    return len(trajectory)
