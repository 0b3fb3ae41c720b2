"""``--version``, ``-h``, and ``python -m slam_bof``."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata

import pytest
from typer.testing import CliRunner

import slam_bof
from slam_bof.cli import app

VERSION = metadata.version("slam-bof")


def test_the_version_is_said_everywhere() -> None:
    assert slam_bof.__version__ == VERSION
    for arguments in (["--version"], ["version"]):
        result = CliRunner().invoke(app, arguments)
        assert (result.exit_code, result.stdout) == (0, f"slam-bof {VERSION}\n")


def test_the_module_runs_as_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "slam_bof", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"slam-bof {VERSION}\n"


@pytest.mark.parametrize("command", [[], ["run"], ["map"], ["map", "info"], ["evaluate", "places"]])
def test_short_and_long_option_of_help(command: list[str]) -> None:
    short, long = (CliRunner().invoke(app, [*command, option]) for option in ("-h", "--help"))
    assert short.exit_code == long.exit_code == 0
    assert short.stdout == long.stdout
    assert "Usage: " in short.stdout
