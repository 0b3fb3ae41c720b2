"""The checks of ``slam-bof doctor``."""

from __future__ import annotations

import ctypes.util
import os
import platform
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from slam_bof.errors import SlamBofError

__all__ = ["Finding", "examine"]

REINSTALL = "pip install --force-reinstall slam-bof"
MIN_FREE_BYTES = 2 * 10**9
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check; ``remedy`` says what to do where ``ok`` is false."""

    what: str
    ok: bool
    found: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Run all checks, also after one that fails."""
    return [
        _python(),
        *_packages(),
        _libusb(),
        _attempt("Open3D import", _open3d, REINSTALL),
        _attempt("Default model", _model, REINSTALL),
        _compiled(),
        _threads(),
        _disk(),
    ]


def _attempt(what: str, check: Callable[[], str], remedy: str) -> Finding:
    try:
        return Finding(what, True, check())
    except (ImportError, OSError, SlamBofError) as error:
        return Finding(what, False, " ".join(str(error).split()), remedy)


def _python() -> Finding:
    found = f"{platform.python_version()} on {platform.platform()}"
    remedy = "install CPython 3.11 or newer"
    ok = sys.version_info >= (3, 11)
    return Finding("Python", ok, found, "" if ok else remedy)


def _packages() -> Iterator[Finding]:
    """Compare the installed version of each dependency with the required one."""
    from packaging.requirements import Requirement

    for text in sorted(metadata.requires("slam-bof") or []):
        need = Requirement(text)
        if need.marker and not need.marker.evaluate():
            continue
        try:
            found = metadata.version(need.name)
        except metadata.PackageNotFoundError:
            found = ""
        ok = bool(found) and need.specifier.contains(found, prereleases=True)
        remedy = "" if ok else f'pip install "{need.name}{need.specifier}"'
        yield Finding(need.name, ok, found or "not installed", remedy)


def _libusb() -> Finding:
    system = ctypes.util.find_library("usb-1.0")
    if system:
        return Finding("libusb", True, f"{system}, from the system")

    def bundled() -> str:
        import libusb_package

        return f"{libusb_package.get_library_path()}, from libusb-package"

    return _attempt("libusb", bundled, "pip install libusb-package")


def _open3d() -> str:
    from slam_bof.core import import_open3d

    return str(import_open3d().__version__)


def _model() -> str:
    from slam_bof.scenes import model

    return f"hash {model.resolve().content_hash[:12]}"


def _compiled() -> Finding:
    from slam_bof.bof import compile_bof
    from slam_bof.geometry import compile_alignment

    compile_bof()
    if folder := compile_alignment():
        return Finding("Compiled code", True, f"kept in {folder}")
    remedy = "set NUMBA_CACHE_DIR to a folder that can be written"
    return Finding("Compiled code", False, "not kept: every run compiles for 40 s", remedy)


def _threads() -> Finding:
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    limits = [f"{name}={os.environ[name]}" for name in THREAD_VARIABLES if name in os.environ]
    return Finding("Threads", True, ", ".join([f"{cpus} CPUs", *limits]))


def _disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free
    ok = free >= MIN_FREE_BYTES
    remedy = "" if ok else "free some space, or choose another folder with run --out"
    return Finding("Disk space here", ok, f"{free / 1e9:.1f} GB free", remedy)
