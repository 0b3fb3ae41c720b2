"""``slam-bof doctor``: checks of the installation."""

from __future__ import annotations

from dataclasses import asdict

import typer

from slam_bof.cli.options import JSON

__all__ = ["doctor"]


def doctor(as_json: JSON = False) -> None:
    """Check Python, libraries, the default model and disk space; exit code 1 for a problem."""
    from slam_bof.cli.console import print_json, print_table
    from slam_bof.cli.doctor_checks import examine

    findings = examine()
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        rows = [(f.what, "ok" if f.ok else "PROBLEM", f.found, f.remedy) for f in findings]
        print_table(("checked", "state", "found", "remedy"), rows)
    if not all(finding.ok for finding in findings):
        raise typer.Exit(1)
