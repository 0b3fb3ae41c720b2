"""Import Open3D so that it works everywhere and gives the same bytes every time."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

__all__ = ["import_open3d"]


@functools.cache
def import_open3d() -> ModuleType:
    """Import Open3D, with a libusb if the system has none, and with one thread.

    Its wheel needs libusb-1.0, which bare machines lack: ``libusb-package`` carries one. Its
    ICP adds up in an order that depends on the threads, so poses would differ in their last
    bits from run to run; one thread keeps the order, and one is enough for a keyframe's cloud.
    """
    if ctypes.util.find_library("usb-1.0") is None:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    with _one_cpu():
        import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@contextmanager
def _one_cpu() -> Iterator[None]:
    """Show one CPU to what is imported: TBB counts them once, and has no other switch here."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cpus = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cpus)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cpus)
