"""``--version``, ``-h``, and ``python -m slam_bof``."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata

import pytest
import typer
from typer.testing import CliRunner

import slam_bof
from slam_bof.cli import app, main
from slam_bof.cli.app import OneLineErrors

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


def test_ctrl_c_before_a_command_has_begun_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("typer.main.get_command", interrupt)
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 130
    assert capsys.readouterr().err == "error: interrupted\n"


@pytest.mark.parametrize(("cause", "code"), [(KeyboardInterrupt(), 130), (ValueError("bug"), 1)])
def test_ctrl_c_within_c_code_is_one_line_too(cause: BaseException, code: int) -> None:
    """Numba's loader reports it so; any other such error is a bug, and shown as one."""
    commands = typer.Typer(cls=OneLineErrors)

    @commands.command()
    def load() -> None:
        raise SystemError("<function> returned a result with an exception set") from cause

    @commands.command()
    def other() -> None:
        pass

    result = CliRunner().invoke(commands, ["load"])
    assert result.exit_code == code
    assert result.stderr == ("error: interrupted\n" if code == 130 else "")
    assert isinstance(result.exception, SystemExit if code == 130 else SystemError)
