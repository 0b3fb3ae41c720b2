"""Depth-only place recognition, loop closing and scene labels for any SLAM front-end."""

import logging
import os
from typing import Any

import lazy_loader

_getattr, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used; find the version in the package's metadata."""
    if name == "__version__":
        from importlib import metadata

        return metadata.version("slam-bof")
    return _getattr(name)


# Modules that README named before there were rooms: importable for one release, with a warning.
__path__ = [*__path__, os.path.join(os.path.dirname(__file__), "deprecated")]

logging.getLogger(__name__).addHandler(logging.NullHandler())
