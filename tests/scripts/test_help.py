"""Every script explains itself."""

import runpy
import subprocess
import sys

import pytest
from conftest import ROOT

SCRIPTS = ROOT / "scripts"
FILES = [
    path
    for path in sorted(SCRIPTS.iterdir())
    if path.is_file() and not path.name.startswith("_") and path.suffix == ""
]
PYTHON = [path for path in FILES if "python" in path.read_text("utf-8").partition("\n")[0]]
SHELL = [path for path in FILES if path not in PYTHON]


def test_there_are_scripts_of_both_kinds():
    assert {path.name for path in SHELL} == {"demo", "test", "try_wheel"}
    assert {"benchmarks", "measure_turns", "make_tours"} <= {path.name for path in PYTHON}


@pytest.mark.parametrize("path", PYTHON, ids=lambda path: path.name)
def test_help_of_a_python_script(path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    monkeypatch.setattr(sys, "argv", [path.name, "--help"])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(path), run_name="__main__")
    assert stopped.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: {path.name}")
    assert path.read_text("utf-8").split('"""')[1].splitlines()[0] in " ".join(out.split())


@pytest.mark.parametrize("path", SHELL, ids=lambda path: path.name)
def test_help_of_a_shell_script(path):
    done = subprocess.run(["bash", str(path), "--help"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "installs" in done.stdout.splitlines()[0]
    assert "set -e" not in done.stdout
