"""Depth-only place recognition, loop closing and scene labels for any SLAM front-end."""

import logging
import os

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Modules that README named before there were rooms: importable for one release, with a warning.
__path__ = [*__path__, os.path.join(os.path.dirname(__file__), "deprecated")]

logging.getLogger(__name__).addHandler(logging.NullHandler())
