"""That what is written about packages, pins and scripts holds together."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from slam_bof.core import registry

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONSTRAINTS = (ROOT / "scripts" / "constraints.txt").read_text(encoding="utf-8").splitlines()
PIN = re.compile(r"([A-Za-z0-9._-]+)==([0-9][A-Za-z0-9.+!]*)")
SCRIPTS = ["scripts/demo", "scripts/test", "scripts/try_wheel", ".ci/run"]


def pins() -> dict[str, str]:
    matches = [PIN.fullmatch(line) for line in CONSTRAINTS if line and not line.startswith("#")]
    assert all(matches), "constraints are lines of name==version and nothing else"
    return {canonicalize_name(match[1]): match[2] for match in matches if match}


def test_every_requirement_is_pinned_to_a_version_that_it_allows() -> None:
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    for text in project["dependencies"] + extras["dev"] + extras["docs"]:
        requirement = Requirement(text)
        name = canonicalize_name(requirement.name)
        assert name in pins(), f"{name} is not pinned in scripts/constraints.txt"
        assert requirement.specifier.contains(pins()[name]), f"{name} {pins()[name]}"


def test_no_pin_is_given_twice() -> None:
    names = [canonicalize_name(line.split("==")[0]) for line in CONSTRAINTS if "==" in line]
    assert len(names) == len(set(names))


def test_gtsam_knows_numpy_2() -> None:
    (requirement,) = [
        Requirement(text) for text in PROJECT["project"]["dependencies"] if text.startswith("gtsam")
    ]
    assert not requirement.specifier.contains("4.2.2")


def test_installed_plugins_are_those_declared() -> None:
    groups = PROJECT["project"]["entry-points"]
    for group, entries in groups.items():
        port = group.removeprefix("slam_bof.")
        installed = {item.name: item.target for item in registry.listing() if item.port == port}
        assert entries.items() <= installed.items(), "install slam_bof again"


@pytest.mark.parametrize("script", SCRIPTS)
def test_scripts_can_be_run_and_stop_at_the_first_error(script: str) -> None:
    path = ROOT / script
    assert os.access(path, os.X_OK)
    subprocess.run(["bash", "-n", str(path)], check=True)
    assert "set -euo pipefail" in path.read_text()


def test_an_old_python_is_told_of_in_one_line(tmp_path: Path) -> None:
    """A copy of the scripts, and a Python that says it is 3.9."""
    (tmp_path / "scripts").mkdir()
    for name in ("test", "_setup.sh", "constraints.txt"):
        (tmp_path / "scripts" / name).write_text((ROOT / "scripts" / name).read_text())
    (tmp_path / "pyproject.toml").write_text("")
    old = tmp_path / "python3"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo "Python 3.9.2" && exit\nexit 1\n')
    old.chmod(0o755)
    done = subprocess.run(
        ["bash", str(tmp_path / "scripts" / "test")],
        env={**os.environ, "PYTHON": str(old)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert done.stderr == (
        "error: found Python 3.9.2, expected CPython 3.11 or newer; set PYTHON to name one\n"
    )
    assert not (tmp_path / ".venv").exists()


def test_what_windows_lacks_is_not_imported_with_the_package() -> None:
    """Modules of POSIX alone may be imported within functions that need them."""
    for package in ("slam_bof", "plugins/slam_bof_plugins"):
        for file in (ROOT / package).rglob("*.py"):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.Import | ast.ImportFrom):
                    names = {alias.name for alias in node.names} | {getattr(node, "module", "")}
                    assert not names & {"fcntl", "resource", "pwd", "grp", "termios"}, file


OUTSIDE = """
import json, sys
from importlib import metadata
import slam_bof
from slam_bof.core import registry
from slam_bof.scenes import model
from slam_bof.slam import preset
assert slam_bof.__file__.startswith(sys.argv[1]), slam_bof.__file__
assert slam_bof.__version__ == metadata.version("slam-bof")
print(json.dumps({
    "model": model.resolve(preset("indoor").model).content_hash,
    "datasets": registry.names("datasets"),
    "readme": metadata.metadata("slam-bof").get_payload(),
}))
"""


def test_the_wheel_is_whole_outside_of_the_repository(tmp_path: Path) -> None:
    """It is installed into an environment of its own, with the libraries of this one.

    ``scripts/try_wheel`` also installs the libraries, from the package index.
    """
    pytest.importorskip("hatch_fancy_pypi_readme", reason="needs pip install slam-bof[dev]")
    build = "from hatchling.build import build_wheel; print(build_wheel(__import__('sys').argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    clean = tmp_path / "clean"
    venv.create(clean, symlinks=True)
    python = clean / "bin" / "python"
    install = ["-m", "pip", "--python", str(python), "install", "-q", "--no-deps", "--no-index"]
    wheel = tmp_path / done.stdout.split()[-1]
    subprocess.run([sys.executable, *install, str(wheel)], check=True, capture_output=True)
    (site,) = clean.glob("lib/python*/site-packages")
    libraries = dict.fromkeys(sysconfig.get_path(name) for name in ("purelib", "platlib"))
    (site / "libraries.pth").write_text("\n".join(libraries))  # without what is editable there
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*command: object) -> str:
        used = subprocess.run(
            list(map(str, command)), cwd=tmp_path, env=environ, capture_output=True, text=True
        )
        assert used.returncode == 0, used.stderr
        return used.stdout

    assert run(clean / "bin" / "slam-bof", "--version").split()[-1] == PROJECT["project"]["version"]
    assert "usage" in run(python, "-m", "slam_bof", "-h").lower()
    found = json.loads(run(python, "-c", OUTSIDE, site))
    assert found["model"]
    assert set(found["datasets"]) >= PROJECT["project"]["entry-points"]["slam_bof.datasets"].keys()
    links = re.findall(r"\]\(([^)]+)\)", found["readme"])
    assert links
    assert all(link.startswith("https://") for link in links), "links work on a package index"
