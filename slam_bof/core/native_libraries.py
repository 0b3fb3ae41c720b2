"""Native libraries: Open3D so that it works everywhere, and each on one thread."""

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
    """Import Open3D, with a libusb if the system has none, and with one thread.

    Its wheel needs libusb-1.0, which bare machines lack: ``libusb-package`` carries one. Its
    ICP adds up in an order that depends on the threads, so poses would differ in their last
    bits from run to run; one thread keeps the order, and one is enough for a keyframe's cloud.
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
    """Hold NumPy's products to one thread, within a ``with`` block or a decorated function.

    Matrices here are small: a second thread doubles the CPU time, waiting for its share, and
    takes hardly anything off the wall's.
    """
    with _blas().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _blas() -> ThreadpoolController:
    """Return the libraries loaded so far; to find them takes longer than most products."""
    return ThreadpoolController()


@contextmanager
def one_cpu() -> Iterator[None]:
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


@contextmanager
def silenced() -> Iterator[None]:
    """Let what native code prints on the standard output go nowhere.

    The stream is the whole process's: what other threads print meanwhile is lost as well.
    """
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        libc.fflush(None)  # what it has buffered still goes nowhere
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
