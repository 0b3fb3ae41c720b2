"""The command line: the only place that prints, and where libraries are imported late."""

from slam_bof.cli.app import app, main

__all__ = ["app", "main"]
