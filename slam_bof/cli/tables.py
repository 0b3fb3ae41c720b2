"""Rows printed as a table, JSON or CSV; options of several numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from typer.core import TyperCommand

from slam_bof.errors import ConfigError

__all__ = ["ListCommand", "flatten", "parse_numbers", "show_rows"]

LISTS = {"--near": 3, "--intrinsics": 4}
"""Options of several numbers, which may be written with commas or with spaces between."""


class ListCommand(TyperCommand):
    """A command, with numbers of a list in one word or in several: ``--near 1 0 2``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the numbers of a list by commas."""
        joined: list[str] = []
        rest = list(args)
        while rest:
            word = rest.pop(0)
            joined.append(word)
            if word in LISTS and rest:
                numbers = [rest.pop(0)]
                while rest and len(numbers) < LISTS[word] and _is_number(rest[0]):
                    numbers.append(rest.pop(0))
                joined.append(",".join(numbers))
        parsed: list[str] = super().parse_args(ctx, joined)
        return parsed


def show_rows(
    rows: list[dict[str, Any]],
    columns: Sequence[tuple[str, str]],
    form: str,
    title: str = "",
    *,
    single: bool = False,
) -> None:
    """Print rows as a table, CSV with all there is, or JSON."""
    import csv
    import sys

    from slam_bof.cli.console import print_json, print_table

    if form == "json":
        print_json(rows[0] if single else rows)
    elif form == "table":
        flat = [flatten(row) for row in rows]
        table = [[row.get(key) for _, key in columns] for row in flat]
        print_table([name for name, _ in columns], table, title=title)
    else:
        flat = [flatten(row) for row in rows]
        names = list(dict.fromkeys(key for row in flat for key in row))
        names = names or [key for _, key in columns]
        writer = csv.DictWriter(sys.stdout, names, lineterminator="\n", restval="")
        writer.writeheader()
        writer.writerows(flat)


def flatten(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row without lists: ``translation_m_0``; probabilities by ``probability_LABEL``."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, tuple) and key.endswith("_ids"):
            flat[key] = " ".join(map(str, value))
        elif isinstance(value, tuple):
            flat |= {f"{key}_{i}": item for i, item in enumerate(value)}
        elif isinstance(value, dict):
            flat |= {f"probability_{name}": item for name, item in sorted(value.items())}
        else:
            flat[key] = value
    return flat


def parse_numbers(option: str, text: str, expected: str) -> list[float]:
    """Return the numbers of an option; ``ConfigError`` says what was expected."""
    words = text.replace(",", " ").split()
    values = [float(word) for word in words if _is_number(word)]
    if len(values) != LISTS[option] or len(words) != LISTS[option]:
        raise ConfigError(f"{option}: found {text!r}, expected {expected}")
    return values


def _is_number(word: str) -> bool:
    try:
        value = float(word)
    except ValueError:
        return False
    return value - value == 0.0
