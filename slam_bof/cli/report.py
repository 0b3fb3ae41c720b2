"""``slam-bof report``: the HTML report of a run, written again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam_bof.cli.options import JSON, out_file

__all__ = ["report"]


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            callback=out_file,
            help="The file to write; by default the run's report.html.",
        ),
    ] = None,
    as_json: JSON = False,
) -> None:
    """Write the HTML report of a run again, from the files in its folder."""
    from slam_bof.cli.console import print_json
    from slam_bof.run import read_run
    from slam_bof.visualization import write_report

    page = out or run / "report.html"
    write_report(page, read_run(run))
    if as_json:
        print_json({"report": str(page)})
    else:
        typer.echo(f"Report: {page}")
