"""What a plug-in must offer. ``slam_bof`` knows its partners only by these protocols.

A plug-in is a class found by an entry point (see ``registry``). One that takes options
declares them as a nested ``Params`` (a ``slam_bof.types.Params``) and is built as
``Plugin(Plugin.Params(...))``; data sets are built by ``open``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from slam_bof.types import (
    Array,
    DepthFrame,
    Intrinsics,
    Keyframe,
    Loop,
    Pose,
    Step,
    Trajectory,
    Verification,
)

__all__ = [
    "Backend",
    "Dataset",
    "DatasetFormat",
    "Descriptor",
    "ForgettingVerifier",
    "LabelledImages",
    "NullObserver",
    "Observer",
    "Odometry",
    "Verifier",
]


@runtime_checkable
class Dataset(Protocol):
    """A sequence of depth frames, read one by one."""

    @property
    def name(self) -> str:
        """The name of the format that the sequence is stored in."""

    sequence: str
    """Scene and sequence, such as ``redkitchen/seq-01``."""
    intrinsics: Intrinsics

    def __len__(self) -> int:
        """Return the number of frames."""

    def frame(self, index: int) -> DepthFrame:
        """Read a frame; raise ``DatasetError`` if its file cannot be read."""

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the (H, W, 3) RGB image registered to the depth image, if there is one."""

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the (H, W) grey image as the colour camera recorded it, if there is one."""

    def groundtruth(self) -> Trajectory | None:
        """Return ``T_world_camera`` of every frame (NaN where unknown), if known of any."""

    def scenes(self) -> tuple[str, ...] | None:
        """Return the true scene label of every frame, if known."""


@runtime_checkable
class DatasetFormat(Protocol):
    """A format in which sequences are stored: what a data-set plug-in is.

    Usually it is the class of its sequences, with ``recognises`` and ``open`` as class methods;
    such a class may inherit from ``Dataset`` for the methods that it does not define.
    """

    @property
    def name(self) -> str:
        """The name of the format, as it is registered."""

    def recognises(self, path: Path) -> str | bool:
        """Return whether a folder or file is of this format, judged by its content.

        A string names what it was recognised by, such as ``rgb.txt, depth.txt``; it is empty if
        the format does not match.
        """

    def open(self, path: Path) -> Dataset:
        """Open a sequence; raise ``DatasetError`` if something is missing or malformed.

        A format that takes options (a nested ``Params``) is opened by ``open(path, params)``.
        """


@runtime_checkable
class LabelledImages(Dataset, Protocol):
    """A data set of single images with scene labels, each with its own camera; no sequence."""

    is_train: NDArray[np.bool_]
    """(N,) whether the official split trains with an image; else it tests with it."""


@runtime_checkable
class Descriptor(Protocol):
    """Describes what a frame shows, by many local features or by one row for all of it."""

    needs_gray: ClassVar[bool]
    """Whether it looks at the grey image; without, depth is all it needs."""
    is_binary: ClassVar[bool]
    """Whether values are bits packed in bytes."""
    comparison: ClassVar[str]
    """How frames are compared: ``bag`` of words learnt of local features; or, of one row a
    frame, ``cosine``, ``l1`` (mean absolute difference) or ``equal`` (share of equal values)."""

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[Any]:
        """Return the descriptors, (M, D) or (M, D / 8) uint8, M = 0 if there are none."""


@runtime_checkable
class Odometry(Protocol):
    """Tracks the camera from frame to frame."""

    def process(self, frame: DepthFrame) -> Pose:
        """Return ``T_odom_camera``, identity for the first frame; never fails on empty frames."""

    def reset(self) -> None:
        """Forget everything: the next frame is a first one."""


@runtime_checkable
class Verifier(Protocol):
    """Decides by geometry whether two keyframes show the same place, and from where."""

    def prepare(self, frame: DepthFrame, points_camera: Array) -> Any:
        """Make of a depth image, or of its points (N, 3), what ``verify`` needs of a keyframe."""

    def verify(
        self,
        query: Any,
        matches: Sequence[Any],
        *,
        T_match_query: Array | None = None,
        seed: int = 0,
    ) -> list[Verification]:
        """Align the query with each match, from guesses (n, 4, 4) or, without any, globally."""


@runtime_checkable
class ForgettingVerifier(Verifier, Protocol):
    """A verifier that keeps what it prepares, and can forget it: for frames that only ask."""

    def forget(self, prepared: Any) -> None:
        """Forget what was prepared last; ``ValueError`` where it is anything else."""


@runtime_checkable
class Backend(Protocol):
    """A pose graph over keyframes."""

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node, and its odometry factor to the node before it.

        Where a segment begins that factor is nearly free: odometry was lost in between.
        """

    def move(self, keyframe_ids: NDArray[np.integer[Any]], T: Pose) -> None:
        """Carry nodes by ``T`` (4, 4) in the map, as one rigid piece; before a loop joins them.

        They are whole segments, tied to the others by nothing but nearly free factors.
        """

    def add_loop(self, loop: Loop) -> None:
        """Add a verified edge, with a robust kernel."""

    def update(self) -> None:
        """Optimise incrementally with all that came since the last call."""

    def optimize(self) -> NDArray[np.float64]:
        """Optimise the whole graph until it converges.

        Returns the weight of each loop in [0, 1], in the order they were added. Those below 0.5
        contradict the rest and were left out.
        """

    def poses(self) -> Array:
        """Return ``T_map_camera`` of every keyframe, (K, 4, 4)."""

    def write_g2o(self, path: Path) -> None:
        """Write the graph as .g2o (translation first, as g2o has it)."""


@runtime_checkable
class Observer(Protocol):
    """Looks on while frames are processed: a progress bar, a live viewer, a test."""

    def on_start(self, n_frames: int) -> None:
        """Take note of how many frames will come."""

    def on_step(self, frame_index: int, step: Step) -> None:
        """Take note of a processed frame."""

    def on_warning(self, message: str) -> None:
        """Take note of something that went wrong but did not stop the run."""


class NullObserver:
    """The observer for when nobody looks."""

    def on_start(self, n_frames: int) -> None:
        """Do nothing."""

    def on_step(self, frame_index: int, step: Step) -> None:
        """Do nothing."""

    def on_warning(self, message: str) -> None:
        """Do nothing."""
