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

from slam_bof.errors import ConfigError, DatasetError, PluginError
from slam_bof.ports import Dataset
from slam_bof.types import Params
from slam_bof.validation import describe_error

__all__ = [
    "PORTS",
    "Listing",
    "build",
    "check_options",
    "listing",
    "load",
    "missing",
    "names",
    "open_dataset",
]

PORTS = ("datasets", "odometry", "verifiers", "backends", "descriptors")
"""The entry-point groups, without their ``slam_bof.`` before it."""

PIP_NAMES = {"cv2": "opencv-python-headless", "sklearn": "scikit-learn", "yaml": "pyyaml"}
"""What pip calls a library, where that is not its import name."""


@dataclass(frozen=True, slots=True)
class Listing:
    """An installed plug-in: its port and name, what it loads, and the package that brought it."""

    port: str
    name: str
    target: str
    distribution: str
    version: str


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


def open_dataset(path: Path, name: str = "auto") -> Dataset:
    """Open a sequence with the data-set plug-in of that name, or the one that recognises it.

    Raises
    ------
    DatasetError
        If there is no such folder, none recognises it, or it is malformed.
    PluginError
        As ``load``.
    """
    if name != "auto":
        opened: Dataset = load("datasets", name).open(path)
        return opened
    if not path.is_dir():
        found = "a file" if path.exists() else "nothing"
        raise DatasetError(f"{path}: found {found}, expected the folder of a sequence")
    layouts = names("datasets")
    for layout in layouts:
        plugin: type[Dataset] = load("datasets", layout)
        if plugin.recognises(path):
            return plugin.open(path)
    raise DatasetError(
        f"{path}: found no known layout, expected one of: {', '.join(layouts) or 'none installed'}"
    )


def _found(port: str) -> dict[str, EntryPoint]:
    if port not in PORTS:
        raise ValueError(f"port must be one of {', '.join(PORTS)}, got {port!r}")
    return {entry.name: entry for entry in entry_points(group=f"slam_bof.{port}")}
