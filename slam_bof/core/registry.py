"""The one place where the name of a plug-in becomes its class.

Plug-ins are entry points of the groups ``slam_bof.<port>``: those that come with slam_bof enter
by the same door as anybody's. Only the one that is named is imported.
"""

from __future__ import annotations

import ast
import importlib.util
import re
from collections.abc import Mapping
from dataclasses import dataclass
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
"""The entry-point groups, without their ``slam_bof.`` before it."""

PIP_NAMES = {"cv2": "opencv-python-headless", "sklearn": "scikit-learn", "yaml": "pyyaml"}
"""What pip calls a library, where that is not its import name."""


N_LISTED = 8
"""How many entries of a folder an error lists."""
HINT = "--dataset NAME says what it lacks to be one of them"


@dataclass(frozen=True, slots=True)
class Listing:
    """An installed plug-in: its port and name, what it loads, and the package that brought it."""

    port: str
    name: str
    target: str
    distribution: str
    version: str


@dataclass(frozen=True, slots=True)
class Recognition:
    """Which data-set plug-in a folder or file is for, and by what that was told."""

    name: str
    why: str

    def __str__(self) -> str:
        """Say both in words."""
        return f"recognised as {self.name}: {self.why}"


def names(port: str) -> list[str]:
    """Return the names of a port's installed plug-ins, sorted; imports none of them."""
    return sorted(_found(port))


def listing() -> list[Listing]:
    """Return all installed plug-ins, by port and name; imports none of them."""
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
        If there is none of that name, or it or a library that it needs cannot be imported.
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
            reason = _remedy(entry, library)
        else:
            reason = f"cannot be loaded: {' '.join(str(error).split())}"
        raise PluginError(f"{port} plug-in {name!r} {reason}") from error


def missing(item: Listing) -> str:
    """Return which library a plug-in lacks and how to get it, empty if none; imports nothing.

    It looks for what the plug-in's module imports, wherever that stands in it.
    """
    entry = _found(item.port)[item.name]
    package = entry.module.split(".")[0]
    try:
        spec = importlib.util.find_spec(entry.module)
        source = Path(spec.origin).read_bytes() if spec and spec.origin else b""
        tree = ast.parse(source)
    except (ImportError, OSError, SyntaxError, ValueError) as error:
        return f"cannot be loaded: {' '.join(str(error).split())}"
    if spec is None:
        return f"cannot be loaded: no module {entry.module}"
    for node in ast.walk(tree):
        modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            modules = [node.module]
        for library in sorted({module.split(".")[0] for module in modules} - {package}):
            if importlib.util.find_spec(library) is None:
                return _remedy(entry, library)
    return ""


def _remedy(entry: EntryPoint, library: str) -> str:
    """Say how to install a library: by the extra that its package has for that, if there is one."""
    package = PIP_NAMES.get(library, library.replace("_", "-"))
    command = f"pip install {package}"
    for text in (entry.dist.requires if entry.dist else None) or []:
        requirement = Requirement(text)
        extra = re.search(r"extra == ['\"]([^'\"]+)", str(requirement.marker or ""))
        if extra and extra[1] != "dev" and canonicalize_name(requirement.name) == package.lower():
            command = f'pip install "{entry.dist.name}[{extra[1]}]"' if entry.dist else command
    return f"needs {library}, which is not installed; try: {command}"


def check_options(port: str, name: str, options: Mapping[str, Any] | None = None) -> Params | None:
    """Check a plug-in's options against its nested ``Params``; None where it has no such.

    Raises
    ------
    PluginError
        As ``load``.
    ConfigError
        If an option is unknown or has a value that it cannot have.
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
    """Make a plug-in with its options; raises as ``check_options``."""
    params = check_options(port, name, options)
    plugin = load(port, name)
    return plugin() if params is None else plugin(params)


def recognise_dataset(path: Path) -> Recognition:
    """Find the data-set plug-in for a folder or file by its content.

    Raises
    ------
    DatasetError
        If there is nothing, no plug-in recognises it, or several do.
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
        If there is no such folder, none or several recognise it, or it is malformed.
    ConfigError, PluginError
        As ``check_options``.
    """
    if name == "auto":
        name = recognise_dataset(path).name
    params = check_options("datasets", name, options)
    plugin = load("datasets", name)
    opened: Dataset = plugin.open(path) if params is None else plugin.open(path, params)
    return opened


def _recognisers(path: Path) -> tuple[list[Recognition], list[str]]:
    """Return who recognises a path, and which plug-ins could not be asked, and why."""
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
    """Say what stands in a folder, and whether one below it would be recognised."""
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
