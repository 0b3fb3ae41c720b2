"""Rows printed as a table, as JSON or as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from slam_bof.cli.options import Format

__all__ = ["flatten", "show_rows"]


def show_rows(
    rows: list[dict[str, Any]],
    columns: Sequence[tuple[str, str]],
    form: Format,
    title: str = "",
) -> None:
    """Print rows as a table, as JSON, or as CSV with all values.

    ``columns`` are the head and the key of each column of the table.
    """
    import csv
    import sys

    from slam_bof.cli.console import print_json, print_table

    if form == "json":
        print_json(rows)
        return
    flat = [flatten(row) for row in rows]
    if form == "table":
        table = [[row.get(key) for _, key in columns] for row in flat]
        print_table([name for name, _ in columns], table, title=title)
        return
    names = list(dict.fromkeys(key for row in flat for key in row))
    names = names or [key for _, key in columns]
    writer = csv.DictWriter(sys.stdout, names, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(flat)


def flatten(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row without lists: ``translation_m_0``; probabilities as ``probability_LABEL``."""
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
