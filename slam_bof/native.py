"""Import Open3D on machines that lack libusb-1.0, which its wheel needs."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
from types import ModuleType

__all__ = ["import_open3d"]


@functools.cache
def import_open3d() -> ModuleType:
    """Import Open3D, after loading the libusb of ``libusb-package`` if the system has none."""
    if ctypes.util.find_library("usb-1.0") is None:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d
