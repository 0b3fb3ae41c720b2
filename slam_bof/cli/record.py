"""``slam-bof record``: a RealSense camera recorded to a folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from slam_bof.cli.options import JSON, QUIET, finite

__all__ = ["record"]


def record(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new folder to record to.")],
    duration: Annotated[
        float | None,
        typer.Option(min=0, callback=finite, help="Seconds to record; by default until Ctrl-C."),
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Stop after this many frames.")] = None,
    color: Annotated[bool, typer.Option("--color", help="Record colour as well as depth.")] = False,
    width: Annotated[int, typer.Option(min=1, help="Width of the depth images in pixels.")] = 640,
    height: Annotated[int, typer.Option(min=1, help="Height of the depth images in pixels.")] = 480,
    fps: Annotated[int, typer.Option(min=1, help="Frames per second.")] = 30,
    serial: Annotated[str | None, typer.Option(help="Serial number of the camera.")] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Record a RealSense camera to a folder that run can read.

    A recording that is interrupted keeps all frames up to then.
    """
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.datasets import FolderWriter, RealSense, RecordResult, record as record_frames

    goal = frames or round((duration or 0) * fps)
    camera = RealSense(serial=serial, width=width, height=height, fps=fps, with_color=color)
    with camera, Bar(f"Recording {folder}", quiet=quiet) as bar:

        def show(result: RecordResult) -> None:
            bar.show(result.n_frames, max(goal, result.n_frames))

        result = record_frames(
            camera,
            FolderWriter(folder, camera),
            n_frames=frames,
            duration_s=duration,
            on_frame=show,
        )
        if result.n_dropped:
            bar.warn(
                f"{result.n_dropped} frames are missing: they arrived faster than they were written"
            )
    if as_json:
        print_json({"folder": str(folder), **asdict(result)})
        return
    typer.echo(f"{folder}: {result.n_frames} frames")
    typer.echo(f"Next: slam-bof run {folder}")
