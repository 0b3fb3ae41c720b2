"""Loading of native libraries, and limits on their threads and their output."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from threadpoolctl import ThreadpoolController

__all__ = ["import_open3d", "one_blas_thread", "one_cpu", "silenced"]


@functools.cache
def import_open3d() -> ModuleType:
    """Import Open3D with a single thread, and with libusb from a package if the system has none.

    The Open3D wheel needs libusb-1.0, which minimal systems lack; ``libusb-package`` provides it.
    With several threads the summation order in Open3D's ICP varies, so that the last bits of
    poses would differ between runs. One thread is enough for the point cloud of a keyframe.
    A program that imported Open3D itself before has its threads, and poses to some 13 digits.
    """
    if ctypes.util.find_library("usb-1.0") is None:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    with one_cpu():
        import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread within a ``with`` block or a decorated function.

    The matrices are small: a second thread doubles the CPU time, mostly by waiting, and hardly
    shortens the wall time.
    """
    with _blas().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _blas() -> ThreadpoolController:
    """Return the controller of the loaded BLAS. It is cached because the search for it is slow."""
    return ThreadpoolController()


@contextmanager
def one_cpu() -> Iterator[None]:
    """Restrict the process to one CPU while a library is imported.

    TBB counts the CPUs once at import and offers no other way to limit its threads here.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cpus = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cpus)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cpus)


@contextmanager
def silenced() -> Iterator[None]:
    """Discard what native code prints on the standard output.

    The stream belongs to the whole process: output of other threads is lost meanwhile as well.
    """
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    saved, devnull = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(devnull, 1)
    try:
        yield
    finally:
        libc.fflush(None)  # discards what is still buffered
        os.dup2(saved, 1)
        os.close(saved)
        os.close(devnull)
