"""``slam-bof download``: data sets from their official sites."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam_bof.cli.options import JSON, QUIET

if TYPE_CHECKING:
    from slam_bof.datasets import Downloaded

__all__ = ["download"]

MEGABYTE = 10**6


def download(
    collection: Annotated[
        str | None, typer.Argument(metavar="DATASET", help="The data set: 7scenes, tum or sunrgbd.")
    ] = None,
    parts: Annotated[
        list[str] | None,
        typer.Argument(metavar="PART...", help="Its parts, such as chess or fr1/desk; or all."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of data sets.")] = Path("data"),
    keep_archive: Annotated[
        bool, typer.Option("--keep-archive", help="Keep the archive after unpacking.")
    ] = False,
    base_url: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Download the archives from this mirror instead."),
    ] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Download a data set from its official site and unpack it; without arguments, list them.

    An interrupted download continues where it stopped. Parts that are present are skipped.
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
        find_archives(collection, part)  # checks all names before the first download
    if not quiet:
        about = CATALOGUE[collection]
        typer.echo(f"{about.title}\nLicence: {about.licence}", err=True)
    done: list[Downloaded] = []
    with ExitStack() as bars:
        shown: dict[str, Bar] = {}

        def show(what: str, n_bytes: int, total: int) -> None:
            if what not in shown:
                bars.close()  # leaves the previous bar as it is
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
        typer.echo(f"{item.folder}{' (already present)' if item.was_there else ''}")


def _list(*, as_json: bool) -> None:
    """Print the data sets and their parts."""
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
    print_table(("data set", "part", "content"), rows)
