"""Options that several commands share, and options of several numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from slam_bof.errors import ConfigError

__all__ = [
    "CAMERA",
    "COMPONENT",
    "COPIES",
    "DATASET",
    "DEPTH_SCALE",
    "EVERY",
    "FORMAT",
    "FRAMES",
    "INTRINSICS",
    "JOBS",
    "JSON",
    "MAP",
    "MAX_FRAMES",
    "N_WORDS",
    "OUT",
    "QUIET",
    "SCHEDULER",
    "SEED",
    "SET",
    "SOURCE",
    "Format",
    "NumbersCommand",
    "finite",
    "out_file",
    "parse_numbers",
]

Format = Literal["table", "json", "csv"]


def finite(value: float | None) -> float | None:
    """Return the value of an option; a usage error if it is NaN or infinite."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number.")
    return value


def out_file(path: Path | None) -> Path | None:
    """Return the file of an option that names one to write, unless it is a named pipe."""
    from slam_bof.core import refuse_named_pipe

    if path is not None:
        refuse_named_pipe(path)
    return path


JOBS = Annotated[
    int, typer.Option("--jobs", "-j", min=1, help="Number of sequences processed at a time.")
]
SCHEDULER = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:PORT",
        help="Process several sequences on the Dask cluster of this scheduler (extra dask).",
    ),
]
METHOD_JOBS = Annotated[
    int, typer.Option("--jobs", "-j", min=1, help="Number of methods evaluated at a time.")
]
METHOD_SCHEDULER = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="Evaluate each method on the Dask cluster of this scheduler (extra dask).",
    ),
]
JSON = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
QUIET = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
SET = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a parameter, such as loops.top_k=3."),
]
OUT = Annotated[
    Path, typer.Option("--out", "-o", help="Folder in which the run's folder is created.")
]
SOURCE = Annotated[
    Path,
    typer.Argument(metavar="SEQUENCE|IMAGE", help="A sequence, or a depth image (PNG, NPY)."),
]
DATASET = Annotated[str, typer.Option(help="Layout of a SEQUENCE; by default it is recognised.")]
FRAMES = Annotated[
    str | None,
    typer.Option(metavar="A:B", help="Use only the frames from A up to, not including, B."),
]
MAX_FRAMES = Annotated[int | None, typer.Option(min=1, help="Stop after this many frames.")]
EVERY = Annotated[int, typer.Option(min=1, help="Use every n-th frame.")]
MAP = Annotated[Path, typer.Argument(metavar="MAP", help="A map.db, or the folder of a run.")]
COMPONENT = Annotated[
    int | None,
    typer.Option(
        min=0, help="Only this component of the pose graph; by default the largest where needed."
    ),
]
SEED = Annotated[
    int, typer.Option(min=0, max=2**32 - 1, help="Seed of everything random, below 2^32.")
]
N_WORDS = Annotated[
    int, typer.Option("--words", min=2, max=1_000_000, help="Words in each vocabulary.")
]
CAMERA = Annotated[
    Path | None,
    typer.Option(
        help="For images listed with groups: JSON with width, height, fx, fy, cx, cy (px), "
        "depth_scale (units a metre) and depth_offset (units to add before); by default "
        "intrinsics.json beside each image.",
    ),
]
COPIES = Annotated[
    int,
    typer.Option(
        min=0,
        help="For images listed with groups: copies of each training image as other sensors would "
        "have measured it.",
    ),
]
FORMAT = Annotated[Format, typer.Option("--format", help="How to print the answer.")]
INTRINSICS = Annotated[
    str | None,
    typer.Option(
        metavar="FX FY CX CY",
        help="For an IMAGE: focal lengths and principal point in pixels. By default those in "
        "intrinsics.json beside the image, or of the map.",
    ),
]
DEPTH_SCALE = Annotated[
    float | None,
    typer.Option(
        min=1.0,
        callback=finite,
        help="For an IMAGE: depth units per metre. By default those of the map, or 1000 (mm).",
    ),
]

N_NUMBERS = {"--near": 3, "--intrinsics": 4}
"""Options of several numbers, which may be separated by commas or by spaces."""


class NumbersCommand(TyperCommand):
    """A command whose options of several numbers may be given as ``--near 1 0 2``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the numbers of one option by commas."""
        joined: list[str] = []
        rest = list(args)
        while rest:
            word = rest.pop(0)
            joined.append(word)
            if word in N_NUMBERS and rest:
                numbers = [rest.pop(0)]
                while rest and len(numbers) < N_NUMBERS[word] and _is_number(rest[0]):
                    numbers.append(rest.pop(0))
                joined.append(",".join(numbers))
        parsed: list[str] = super().parse_args(ctx, joined)
        return parsed


def parse_numbers(option: str, text: str, expected: str) -> list[float]:
    """Return the numbers of an option; ``ConfigError`` says what was expected."""
    words = text.replace(",", " ").split()
    values = [float(word) for word in words if _is_number(word)]
    if len(values) != N_NUMBERS[option] or len(words) != N_NUMBERS[option]:
        raise ConfigError(f"{option}: found {text!r}, expected {expected}")
    return values


def _is_number(word: str) -> bool:
    try:
        value = float(word)
    except ValueError:
        return False
    return value - value == 0.0
