"""Loading of native libraries, and limits on their threads and their output."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType

from threadpoolctl import LibController, ThreadpoolController

__all__ = ["import_open3d", "one_blas_thread", "one_cpu", "one_native_thread", "silenced"]


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
    shortens the wall time. The limit is one of the whole process: while a block runs in one
    thread, BLAS has one thread in all. The last block to end restores what the first one found.
    """
    with _limited_blas(_blas()):
        yield


@contextmanager
def one_native_thread() -> Iterator[None]:
    """Limit BLAS and, in this thread, OpenMP to one thread, so that sums have one order.

    Libraries that were loaded since the last call are included.
    """
    controller = ThreadpoolController()
    # OpenMP has a limit for each thread, which can be restored in any order.
    with (
        _limited_blas(controller.select(user_api="blas")),
        controller.limit(limits=1, user_api="openmp"),
    ):
        yield


@dataclass(slots=True)
class _Limit:
    """A library whose threads are limited by a number of blocks, and what the first one found."""

    library: LibController
    n_threads: int
    n_blocks: int = 0


_limits: dict[str, _Limit] = {}
_limits_lock = threading.Lock()


@contextmanager
def _limited_blas(controller: ThreadpoolController) -> Iterator[None]:
    libraries = controller.lib_controllers
    with _limits_lock:
        for library in libraries:
            if library.filepath not in _limits:
                _limits[library.filepath] = _Limit(library, library.num_threads)
                _set_threads(library, 1)
            _limits[library.filepath].n_blocks += 1
    try:
        yield
    finally:
        with _limits_lock:
            for library in libraries:
                limit = _limits[library.filepath]
                limit.n_blocks -= 1
                if not limit.n_blocks:
                    _set_threads(limit.library, limit.n_threads)
                    del _limits[library.filepath]


def _set_threads(library: LibController, n_threads: int) -> None:
    """Set the number of threads of a library, from whichever thread.

    threadpoolctl ignores all threads but the first one that has set a limit, since it does not
    count limits that overlap. Then the first block to begin could never be ended by another.
    """
    set_threads = getattr(library, "_real_set_num_threads", library.set_num_threads)
    set_threads(n_threads)


@functools.cache
def _blas() -> ThreadpoolController:
    """Return the controller of the loaded BLAS. It is cached because the search for it is slow."""
    return ThreadpoolController().select(user_api="blas")


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
