"""What holds for the whole source: the direction of imports, who prints, what is public."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# Each room imports only from those above it, through their doors.
# This is the one place that says so.
_FLOORS = """
    errors types ports
    core
    geometry
    bof places tracking datasets synthetic
    loops scenes
    slam evaluation
    store visualization
    maps atlas
    run
    cli
"""
ROOMS = _FLOORS.split()

# Of no floor: what plug-ins test themselves with, names that are on their way out, and
# ``python -m slam_bof``.
APART = {"testing", "deprecated", "__main__"}

# What a plug-in may know of slam_bof: its records, its helpers, and how depth becomes points,
# views and descriptors.
OPEN_TO_PLUGINS = {"errors", "types", "ports", "core", "geometry", "bof"}

PACKAGES = {"slam_bof": ROOT / "slam_bof", "slam_bof_plugins": ROOT / "plugins/slam_bof_plugins"}


def modules() -> Iterator[tuple[str, Path]]:
    for package, folder in PACKAGES.items():
        for file in sorted(folder.rglob("*.py")):
            parts = file.relative_to(folder).with_suffix("").parts
            yield ".".join((package, *(part for part in parts if part != "__init__"))), file


MODULES = dict(modules())


def room(module: str) -> str:
    """The first component below the package: ``slam_bof.cli.maps`` -> ``cli``."""
    return [*module.split("."), ""][1]


def is_door(module: str) -> bool:
    return module.count(".") == 1


def imported(file: Path, module: str) -> Iterator[tuple[int, str]]:
    """Every import anywhere in a file, with its line, as a full module name."""
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parts, base] if base else parts)
            for alias in node.names:
                full = f"{base}.{alias.name}"
                yield node.lineno, full if base == "slam_bof" or full in MODULES else base


INSIDE = [name for name in MODULES if name.startswith("slam_bof.")]


def test_every_module_has_a_room() -> None:
    rooms = {room(name) for name in INSIDE} - APART
    assert rooms - set(ROOMS) == set(), "put new rooms into ROOMS, where they belong"
    assert set(ROOMS) - rooms == set(), "these rooms are gone"


@pytest.mark.parametrize("module", INSIDE)
def test_a_module_imports_only_from_rooms_above_and_by_their_doors(module: str) -> None:
    above = ROOMS if room(module) in APART else ROOMS[: ROOMS.index(room(module))]
    for line, name in imported(MODULES[module], module):
        package = name.split(".")[0]
        assert package != "slam_bof_plugins", f"{module}:{line} imports {name}"
        if package == "slam_bof" != name and room(name) != room(module):
            assert room(name) in above, f"{module}:{line} imports {name} from a room below"
            assert is_door(name) or name.split(".", 2)[2] in SUBMODULES_AT_DOORS[room(name)], (
                f"{module}:{line} imports {name}, not through the door of {room(name)}"
            )


def submodules_at_door(package: Path) -> set[str]:
    """The modules that a door hands on whole, such as ``se3``."""
    stub = package / "__init__.pyi"
    if not stub.is_file():
        return set()
    return {
        alias.name
        for node in ast.parse(stub.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom) and node.module is None
        for alias in node.names
    }


SUBMODULES_AT_DOORS = {name: submodules_at_door(ROOT / "slam_bof" / name) for name in ROOMS}


@pytest.mark.parametrize("name", [name for name in ROOMS if (ROOT / "slam_bof" / name).is_dir()])
def test_no_circle_inside_a_room(name: str) -> None:
    modules = [module for module in INSIDE if room(module) == name]
    graph = {
        module: {
            target
            for _, target in imported(MODULES[module], module)
            if target in modules and target != module and target != f"slam_bof.{name}"
        }
        for module in modules
    }
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


@pytest.mark.parametrize("name", [name for name in ROOMS if (ROOT / "slam_bof" / name).is_dir()])
def test_every_name_at_a_door_is_there(name: str) -> None:
    door = import_module(f"slam_bof.{name}")
    for public in door.__all__:
        getattr(door, public)


@pytest.mark.parametrize(
    "name", ["live", "queries", "records", "relocating", "scene_map", "writer"]
)
def test_modules_that_readme_named_are_importable_with_a_warning(name: str) -> None:
    sys.modules.pop(f"slam_bof.{name}", None)
    with pytest.warns(DeprecationWarning, match=f"slam_bof.{name} is now slam_bof"):
        module = import_module(f"slam_bof.{name}")
    for public in module.__all__:
        getattr(module, public)


def test_tests_mirror_the_rooms() -> None:
    folders = {path.name for path in (ROOT / "tests").iterdir() if any(path.glob("test_*.py"))}
    assert folders <= {*ROOMS, "plugins", "scripts", "testing"}


@pytest.mark.parametrize("module", [n for n in MODULES if n.startswith("slam_bof_plugins")])
def test_plugins_import_only_what_is_open_to_them(module: str) -> None:
    for line, name in imported(MODULES[module], module):
        if name.split(".")[0] == "slam_bof":
            assert room(name) in OPEN_TO_PLUGINS, f"{module}:{line} imports {name}"


def test_open3d_comes_in_by_one_door() -> None:
    found = {
        module
        for module, file in MODULES.items()
        for _, name in imported(file, module)
        if name.split(".")[0] == "open3d"
    }
    assert found == {"slam_bof.core.native_libraries"}


@pytest.mark.parametrize("module", [name for name in MODULES if room(name) != "cli"])
def test_only_the_command_line_prints_or_exits(module: str) -> None:
    for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in {"print", "exit", "quit", "sys.exit", "os._exit"}, (
                f"{module}:{node.lineno} calls {called}"
            )


def public_names(file: Path) -> tuple[list[str] | None, set[str]]:
    """A module's ``__all__``, and what its top level defines or imports."""
    declared: list[str] | None = None
    names: set[str] = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {
                target.id
                for top in targets
                for target in (top.elts if isinstance(top, ast.Tuple) else [top])
                if isinstance(target, ast.Name)
            }
            if node.value is not None and "__all__" in map(ast.unparse, targets):
                declared = list(ast.literal_eval(node.value))
    return declared, names


@pytest.mark.parametrize(
    "module", [n for n in MODULES if n not in ("slam_bof_plugins", "slam_bof.__main__")]
)
def test_every_module_says_what_is_public(module: str) -> None:
    declared, names = public_names(MODULES[module])
    if "__all__" in names and declared is None:
        return  # a door: its stub says what is public, and another test opens it
    assert declared is not None, "no __all__"
    assert len(declared) == len(set(declared))
    if "__getattr__" not in names:  # tests/test_imports.py asks for those that come lazily
        assert set(declared) <= names, "__all__ names what is not there"


def tracked_files() -> list[Path]:
    try:
        listed = subprocess.run(
            ["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, check=True, text=True
        ).stdout.split("\0")
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs git and its checkout")
    return [ROOT / name for name in listed if name and (ROOT / name).is_file()]


# Somebody's machine; /dev, /usr/bin and the like are everybody's.
ABSOLUTE_PATH = re.compile(r"(?<![\w.:/<$}])(/home/|/root/|/Users/|/work/|/tmp/|/opt/|[A-Z]:\\)\w")


def test_no_tracked_file_names_a_place_on_one_machine() -> None:
    found = []
    for file in tracked_files():
        if file == Path(__file__):
            continue
        try:
            lines = file.read_text(encoding="utf-8").splitlines()
        except UnicodeDecodeError:
            continue
        found += [
            f"{file.relative_to(ROOT)}:{number}: {line.strip()}"
            for number, line in enumerate(lines, start=1)
            if ABSOLUTE_PATH.search(line)
        ]
    assert found == []


def test_the_path_pattern_knows_paths() -> None:
    assert ABSOLUTE_PATH.search('open("/home/me/data")')
    assert ABSOLUTE_PATH.search("cd /root/x")
    assert not ABSOLUTE_PATH.search("#!/usr/bin/env bash, https://example.org/home/x, a/tmp/b")


def test_no_data_is_tracked() -> None:
    """Nor pictures, but for small ones of synthetic scenes that the documentation shows."""
    kinds = {".png", ".jpg", ".jpeg", ".bag", ".ply", ".pcd", ".db", ".npy", ".npz", ".pkl"}
    tracked = {file for file in tracked_files() if file.suffix in kinds}
    pictures = {file for file in tracked if file.parent == ROOT / "docs" / "assets"}
    assert tracked == pictures
    assert all(picture.stat().st_size < 300_000 for picture in pictures)


def test_import_walker_sees_functions_and_type_checking(tmp_path: Path) -> None:
    file = tmp_path / "points.py"
    file.write_text(
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    from slam_bof import run\n"
        "def f():\n    import slam_bof.cli.maps\n    from .. import slam\n"
    )
    found = {name for _, name in imported(file, "slam_bof.geometry.points")}
    assert {"slam_bof.run", "slam_bof.cli.maps", "slam_bof.slam"} <= found
