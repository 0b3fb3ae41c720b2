"""Commands that bring data: ``download`` and ``record``."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam_bof.cli.options import JSON, QUIET

if TYPE_CHECKING:
    from slam_bof.datasets import Downloaded

__all__ = ["download", "record"]

MEGABYTE = 10**6


def download(
    collection: Annotated[
        str | None, typer.Argument(metavar="DATASET", help="7scenes, tum or sunrgbd.")
    ] = None,
    parts: Annotated[
        list[str] | None,
        typer.Argument(metavar="PART...", help="Such as chess, or fr1/desk; or all."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for data sets.")] = Path("data"),
    keep_archive: Annotated[
        bool, typer.Option("--keep-archive", help="Keep what was downloaded after unpacking.")
    ] = False,
    base_url: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Folder of a mirror with the archives."),
    ] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Download a data set from its official place and unpack it; without arguments, list them.

    A download that was cut goes on where it stopped; what is there is not downloaded again.
    """
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.datasets import CATALOGUE, download as downloads, find_archives

    if collection is None:
        _list(as_json=as_json)
        return
    wanted: list[str | None] = list(parts or []) or [None]
    if wanted == ["all"] and collection in CATALOGUE:
        wanted = list(CATALOGUE[collection].parts)
    for part in wanted:
        find_archives(collection, part)  # all names, before the first byte
    if not quiet:
        about = CATALOGUE[collection]
        typer.echo(f"{about.title}\nLicence: {about.licence}", err=True)
    done: list[Downloaded] = []
    with ExitStack() as bars:
        shown: dict[str, Bar] = {}

        def show(what: str, n_bytes: int, total: int) -> None:
            if what not in shown:
                bars.close()  # the one before stands as it is
                shown[what] = bars.enter_context(Bar(f"{what} (MB)", quiet=quiet))
            shown[what].show(n_bytes // MEGABYTE, max(total, n_bytes) // MEGABYTE)

        for part in wanted:
            done += downloads.download(
                collection,
                part,
                out,
                base_url=base_url,
                keep_archive=keep_archive,
                on_progress=show,
            )
    if as_json:
        print_json([{"folder": str(item.folder), "was_there": item.was_there} for item in done])
        return
    for item in done:
        typer.echo(f"{item.folder}{' (was there already)' if item.was_there else ''}")


def record(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new folder to record to.")],
    duration: Annotated[
        float | None, typer.Option(min=0, help="Stop after so many seconds; else at Ctrl-C.")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")] = None,
    color: Annotated[
        bool, typer.Option("--color", help="Record colour too; by default, depth alone.")
    ] = False,
    width: Annotated[int, typer.Option(min=1, help="Of the depth images, in px.")] = 640,
    height: Annotated[int, typer.Option(min=1, help="Of the depth images, in px.")] = 480,
    fps: Annotated[int, typer.Option(min=1, help="Frames a second.")] = 30,
    serial: Annotated[str | None, typer.Option(help="Of the camera, if there are several.")] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Record a RealSense camera to a folder that run reads; what is written stays if killed."""
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
            bar.warn(f"{result.n_dropped} frames of the camera came too fast and are missing")
    if as_json:
        print_json({"folder": str(folder), **asdict(result)})
        return
    typer.echo(f"{folder}: {result.n_frames} frames")
    typer.echo(f"Next: slam-bof run {folder}")


def _list(*, as_json: bool) -> None:
    """Print what can be downloaded."""
    from slam_bof.cli.console import print_json, print_table
    from slam_bof.datasets import CATALOGUE

    if as_json:
        print_json({name: list(item.parts) for name, item in CATALOGUE.items()})
        return
    rows = [
        (name, part, item.title)
        for name, item in CATALOGUE.items()
        for part in (item.parts if len(item.parts) > 1 else [""])
    ]
    print_table(("data set", "part", ""), rows)
