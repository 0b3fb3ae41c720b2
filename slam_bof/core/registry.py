"""The plug-in registry: it finds and imports plug-ins by name.

Plug-ins are entry points of the groups ``slam_bof.<port>``. Those that come with slam_bof are
found in the same way as those of other packages. Only the plug-in that is named is imported.
"""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pydantic import ValidationError

from slam_bof.core.validation import describe_error
from slam_bof.errors import ConfigError, DatasetError, PluginError
from slam_bof.ports import Dataset, DatasetFormat
from slam_bof.types import Params

__all__ = [
    "PORTS",
    "Listing",
    "Recognition",
    "build",
    "check_options",
    "listing",
    "load",
    "missing",
    "names",
    "open_dataset",
    "recognise_dataset",
]

PORTS = ("datasets", "odometry", "verifiers", "backends", "descriptors")
"""The entry-point groups without their prefix ``slam_bof.``."""

PIP_NAMES = {"cv2": "opencv-python-headless", "sklearn": "scikit-learn", "yaml": "pyyaml"}
"""Names on PyPI of libraries whose import name differs."""

N_LISTED = 8
"""Number of entries of a folder that an error message lists."""
HINT = "--dataset NAME says what is missing for that layout"


@dataclass(frozen=True, slots=True)
class Listing:
    """An installed plug-in: its port, name and import target, and the package it comes from."""

    port: str
    name: str
    target: str
    distribution: str
    version: str


@dataclass(frozen=True, slots=True)
class Recognition:
    """The data-set plug-in that reads a folder or file, and the files that identify it."""

    name: str
    why: str

    def __str__(self) -> str:
        """Return both in words."""
        return f"recognised as {self.name}: {self.why}"


def names(port: str) -> list[str]:
    """Return the sorted names of the installed plug-ins of a port, without importing them."""
    return sorted(_found(port))


def listing() -> list[Listing]:
    """Return all installed plug-ins, sorted by port and name, without importing them."""
    return [
        Listing(
            port,
            name,
            entry.value,
            entry.dist.name if entry.dist else "",
            entry.dist.version if entry.dist else "",
        )
        for port in PORTS
        for name, entry in sorted(_found(port).items())
    ]


def load(port: str, name: str) -> Any:
    """Import the plug-in ``name`` of a port and return its class.

    Raises
    ------
    PluginError
        If no plug-in has that name, or it or a library that it needs cannot be imported.
    """
    found = _found(port)
    if name not in found:
        installed = ", ".join(sorted(found)) or "none"
        raise PluginError(f"no {port} plug-in {name!r}; installed: {installed}")
    entry = found[name]
    try:
        return entry.load()
    except (ImportError, AttributeError, OSError) as error:
        library = (getattr(error, "name", None) or "").partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and library not in (
            "",
            entry.module.split(".")[0],
        ):
            reason = _install_hint(entry, library)
        else:
            reason = f"cannot be loaded: {' '.join(str(error).split())}"
        raise PluginError(f"{port} plug-in {name!r} {reason}") from error


def missing(item: Listing) -> str:
    """Return which library a plug-in lacks and how to install it, or an empty string if none.

    The source is searched for import statements; nothing is imported. The search covers the whole
    module of the plug-in, and the modules of its own package that it imports at module level.
    """
    entry = _found(item.port)[item.name]
    package = entry.module.split(".")[0]
    modules, visited = [entry.module], set()
    while modules:
        module = modules.pop()
        visited.add(module)
        try:
            tree = _parse_module(module)
        except (ImportError, OSError, SyntaxError, ValueError) as error:
            return f"cannot be loaded: {' '.join(str(error).split())}"
        for name in sorted(_imported(ast.walk(tree), module)):
            library = name.split(".")[0]
            if library != package and importlib.util.find_spec(library) is None:
                return _install_hint(entry, library)
        own = (name for name in _imported(tree.body, module) if name.split(".")[0] == package)
        modules += sorted(name for name in own if name not in visited and _find(name))
    return ""


def _find(module: str) -> ModuleSpec | None:
    """Find a module without importing its parent packages."""
    root, *names = module.split(".")
    spec = importlib.util.find_spec(root)
    for name in names:
        if spec is None or spec.submodule_search_locations is None:
            return None
        path = list(spec.submodule_search_locations)
        spec = PathFinder.find_spec(f"{spec.name}.{name}", path)
    return spec


def _parse_module(module: str) -> ast.Module:
    spec = _find(module)
    if spec is None:
        raise ImportError(f"no module {module}")
    return ast.parse(Path(spec.origin).read_bytes() if spec.origin else b"")


def _imported(nodes: Iterable[ast.AST], module: str) -> Iterator[str]:
    """Yield the full names of imported modules, and of the names imported from them."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name(
                "." * node.level + (node.module or ""), module.rpartition(".")[0]
            )
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _install_hint(entry: EntryPoint, library: str) -> str:
    """Return how to install a library, by an extra of the plug-in's package if there is one."""
    package = PIP_NAMES.get(library, library.replace("_", "-"))
    command = f"pip install {package}"
    for text in (entry.dist.requires if entry.dist else None) or []:
        requirement = Requirement(text)
        extra = re.search(r"extra == ['\"]([^'\"]+)", str(requirement.marker or ""))
        if extra and extra[1] != "dev" and canonicalize_name(requirement.name) == package.lower():
            command = f'pip install "{entry.dist.name}[{extra[1]}]"' if entry.dist else command
    return f"needs {library}, which is not installed; try: {command}"


def check_options(port: str, name: str, options: Mapping[str, Any] | None = None) -> Params | None:
    """Validate the options of a plug-in; return None if it has no nested class ``Params``.

    Raises
    ------
    PluginError
        If the plug-in cannot be loaded (see ``load``).
    ConfigError
        If an option is unknown or its value is invalid.
    """
    plugin = load(port, name)
    where = f"{port} plug-in {name!r}"
    if not hasattr(plugin, "Params"):
        if options:
            raise ConfigError(f"{where}: takes no options, found {', '.join(options)}")
        return None
    try:
        params: Params = plugin.Params.model_validate(dict(options or {}))
    except ValidationError as error:
        raise ConfigError(f"{where}: {describe_error(error, plugin.Params)}") from error
    return params


def build(port: str, name: str, options: Mapping[str, Any] | None = None) -> Any:
    """Build a plug-in with its options; it raises the errors of ``check_options``."""
    params = check_options(port, name, options)
    plugin = load(port, name)
    return plugin() if params is None else plugin(params)


def recognise_dataset(path: Path) -> Recognition:
    """Find the data-set plug-in that recognises the content of a folder or file.

    Raises
    ------
    DatasetError
        If the path does not exist, or no plug-in or more than one recognises it.
    """
    if not path.exists():
        raise DatasetError(f"{path}: found nothing, expected the folder of a sequence")
    found, missing = _recognisers(path)
    if len(found) == 1:
        return found[0]
    if found:
        reasons = " and ".join(f"{item.name} ({item.why})" for item in found)
        raise DatasetError(
            f"{path}: found {reasons}, expected one layout; choose by --dataset {found[0].name} "
            f"or {', '.join(item.name for item in found[1:])}"
        )
    layouts = ", ".join(names("datasets")) or "none installed"
    if path.is_dir():
        expected = f"found no known layout, expected one of: {layouts}"
        said = "; ".join([expected, _content(path), HINT, *missing])
    else:
        found_file = "a file" if path.stat().st_size else "an empty file"
        expected = f"expected the folder of a sequence, or a file that one of {layouts} reads"
        said = "; ".join([f"found {found_file}, {expected}", HINT, *missing])
    raise DatasetError(f"{path}: {said}")


def open_dataset(
    path: Path, name: str = "auto", options: Mapping[str, Any] | None = None
) -> Dataset:
    """Open a sequence with the data-set plug-in of that name, or the one that recognises it.

    Raises
    ------
    DatasetError
        If the folder does not exist, no plug-in or more than one recognises it, or it is
        malformed.
    ConfigError, PluginError
        See ``check_options``.
    """
    if name == "auto":
        name = recognise_dataset(path).name
    params = check_options("datasets", name, options)
    plugin = load("datasets", name)
    opened: Dataset = plugin.open(path) if params is None else plugin.open(path, params)
    return opened


def _recognisers(path: Path) -> tuple[list[Recognition], list[str]]:
    """Return the plug-ins that recognise a path, and why others could not be loaded."""
    found, missing = [], []
    for layout in names("datasets"):
        try:
            plugin: DatasetFormat = load("datasets", layout)
        except PluginError as error:
            missing.append(str(error))
            continue
        why = plugin.recognises(path)
        if why:
            found.append(Recognition(layout, why if isinstance(why, str) else "its content"))
    return found, missing


def _content(path: Path) -> str:
    """Describe the content of a folder, and suggest a subfolder that is recognised."""
    entries = sorted(path.iterdir())
    listed = [entry.name + "/" * entry.is_dir() for entry in entries[:N_LISTED]]
    if len(entries) > N_LISTED:
        listed.append(f"{len(entries) - N_LISTED} more")
    said = f"in it: {', '.join(listed) or 'nothing'}"
    for folder in (entry for entry in entries[:N_LISTED] if entry.is_dir()):
        found, _ = _recognisers(folder)
        if found:
            return f"{said}; did you mean {folder} ({found[0].name})?"
    return said


def _found(port: str) -> dict[str, EntryPoint]:
    if port not in PORTS:
        raise ValueError(f"port must be one of {', '.join(PORTS)}, got {port!r}")
    return {entry.name: entry for entry in entry_points(group=f"slam_bof.{port}")}
