"""Depth-only place recognition, loop closing and scene labels for any SLAM front-end."""

from __future__ import annotations

import importlib
import logging
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slam_bof.config import Config
    from slam_bof.errors import SlamBofError
    from slam_bof.minislam import MiniSlam
    from slam_bof.recogniser import PlaceRecogniser
    from slam_bof.slam import LoopCloser
    from slam_bof.types import (
        Bag,
        DepthFrame,
        Intrinsics,
        Keyframe,
        Loop,
        Scene,
        Step,
        Trajectory,
    )

__all__ = [
    "Bag",
    "Config",
    "DepthFrame",
    "Intrinsics",
    "Keyframe",
    "Loop",
    "LoopCloser",
    "MiniSlam",
    "PlaceRecogniser",
    "Scene",
    "SlamBofError",
    "Step",
    "Trajectory",
]

_HOMES = {
    "Config": "config",
    "LoopCloser": "slam",
    "MiniSlam": "minislam",
    "PlaceRecogniser": "recogniser",
    "SlamBofError": "errors",
}

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: the command line starts without NumPy."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES.get(name, 'types')}"), name)


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted({*globals(), *__all__})
