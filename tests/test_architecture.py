"""What holds for the whole source: the direction of imports, who prints, what is public."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# A module imports only from rows above its own. This is the one place that says so.
_ROWS = """
    errors types validation native scratch stack se3 timing trajectory judgement ports
    points layers contours bof packing vocabulary index places
    views gravity clouds live viewstack spectra panorama slices agreement alignment
    recogniser fusion tracking
    machines scenes levelled profile shapes network levels labelling
    scene_filter scene_smoothing regions scene_map images
    keyframes rankings loops covisibility parts consistency joining verification
    fitting witnesses aliases localization
    model single
    schema layout upgrades rows mapfile store records writer integrity queries
    download_catalogue download_http download_archive download recording realsense
    registry labelled config excerpt graph history keyframe_map slam minislam
    mapping pruning recovery merging relocating
    graph_file occupancy exporting
    evaluation pose_accuracy recognition metrics synthetic testing training bench retrieval
    scene_splits scene_scores scene_methods scene_protocols
    scene_training
    figures scene_figures matrices page misses scene_page report runs run_folder run cli
"""
ORDER = _ROWS.split()

# What a plug-in may know of slam_bof: its records, its helpers, and how depth becomes points
# and descriptors.
OPEN_TO_PLUGINS = set(
    [
        "errors",
        "types",
        "validation",
        "native",
        "se3",
        "trajectory",
        "ports",
        "points",
        "bof",
        "places",
        "views",
        "alignment",
        "judgement",
    ]
)

PACKAGES = {"slam_bof": ROOT / "slam_bof", "slam_bof_plugins": ROOT / "plugins/slam_bof_plugins"}


def modules() -> Iterator[tuple[str, Path]]:
    for package, folder in PACKAGES.items():
        for file in sorted(folder.rglob("*.py")):
            parts = file.relative_to(folder).with_suffix("").parts
            yield ".".join((package, *(part for part in parts if part != "__init__"))), file


MODULES = dict(modules())


def row(module: str) -> str:
    """The first component below the package: ``slam_bof.cli.maps`` -> ``cli``."""
    return [*module.split("."), ""][1]


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


def test_every_module_has_a_row() -> None:
    rows = {row(name) for name in MODULES if name.startswith("slam_bof.")}
    assert rows - set(ORDER) == set(), "put new modules into ORDER, where they belong"
    assert set(ORDER) - rows == set(), "these modules are gone"
    assert len(ORDER) == len(set(ORDER))


@pytest.mark.parametrize("module", [name for name in MODULES if name.startswith("slam_bof.")])
def test_a_module_imports_only_from_rows_above(module: str) -> None:
    allowed = ORDER[: ORDER.index(row(module))]
    for line, name in imported(MODULES[module], module):
        package = name.split(".")[0]
        assert package != "slam_bof_plugins", f"{module}:{line} imports {name}"
        if package == "slam_bof" and row(name) != row(module):
            assert row(name) in allowed, f"{module}:{line} imports {name} from a row below"


@pytest.mark.parametrize("module", [n for n in MODULES if n.startswith("slam_bof_plugins")])
def test_plugins_import_only_what_is_open_to_them(module: str) -> None:
    for line, name in imported(MODULES[module], module):
        if name.split(".")[0] == "slam_bof":
            assert row(name) in OPEN_TO_PLUGINS, f"{module}:{line} imports {name}"


def test_open3d_comes_in_by_one_door() -> None:
    found = {
        module
        for module, file in MODULES.items()
        for _, name in imported(file, module)
        if name.split(".")[0] == "open3d"
    }
    assert found == {"slam_bof.native"}


@pytest.mark.parametrize("module", [name for name in MODULES if row(name) != "cli"])
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
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
            if node.value is not None and "__all__" in map(ast.unparse, targets):
                declared = list(ast.literal_eval(node.value))
    return declared, names


@pytest.mark.parametrize("module", [n for n in MODULES if n != "slam_bof_plugins"])
def test_every_module_says_what_is_public(module: str) -> None:
    declared, names = public_names(MODULES[module])
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
    kinds = {".png", ".jpg", ".jpeg", ".bag", ".ply", ".pcd", ".db", ".npy", ".npz", ".pkl"}
    assert [file.name for file in tracked_files() if file.suffix in kinds] == []


def test_import_walker_sees_functions_and_type_checking(tmp_path: Path) -> None:
    file = tmp_path / "points.py"
    file.write_text(
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    from slam_bof import run\n"
        "def f():\n    import slam_bof.cli.maps\n    from . import slam\n"
    )
    found = {name for _, name in imported(file, "slam_bof.points")}
    assert {"slam_bof.run", "slam_bof.cli.maps", "slam_bof.slam"} <= found
