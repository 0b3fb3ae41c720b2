"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["FRAMES", "JSON", "MAP", "OUT", "QUIET", "SET"]

JSON = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
QUIET = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
SET = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a parameter, such as loops.top_k=3."),
]
OUT = Annotated[Path, typer.Option("--out", "-o", help="Where runs get their folders.")]
FRAMES = Annotated[
    str | None,
    typer.Option(metavar="A:B", help="Only the frames from A up to B, as 400:1000; not B."),
]
MAP = Annotated[Path, typer.Argument(metavar="MAP", help="A map.db, or the folder of a run.")]
