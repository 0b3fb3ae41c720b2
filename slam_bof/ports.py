"""What a plug-in must offer. ``slam_bof`` knows its partners only by these protocols.

A plug-in is a class found by an entry point (see ``registry``). One that takes options
declares them as a nested ``Params`` (a ``slam_bof.types.Params``) and is built as
``Plugin(Plugin.Params(...))``; data sets are built by ``open``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

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
    """A sequence of depth frames on disk, read one by one."""

    name: ClassVar[str]
    sequence: str
    """Scene and sequence, such as ``redkitchen/seq-01``."""
    intrinsics: Intrinsics

    @classmethod
    def recognises(cls, path: Path) -> str | bool:
        """Tell whether a folder or file is of this layout, by its content.

        The best answer says by what, such as ``rgb.txt, depth.txt``, empty if it is not.
        """

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a sequence; ``DatasetError`` names what is missing or malformed.

        One that takes options (a nested ``Params``) is opened by ``open(path, params)``.
        """

    def __len__(self) -> int:
        """Return the number of frames."""

    def frame(self, index: int) -> DepthFrame:
        """Read a frame; ``DatasetError`` where the file cannot be read."""

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the (H, W, 3) RGB image registered to the depth image, if there is one."""

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the (H, W) grey image as the colour camera recorded it, if there is one."""

    def groundtruth(self) -> Trajectory | None:
        """Return ``T_world_camera`` of every frame (NaN where unknown), if there are any."""

    def scenes(self) -> tuple[str, ...] | None:
        """Return the true scene label of every frame, if there are any."""


@runtime_checkable
class LabelledImages(Dataset, Protocol):
    """A data set of single images with scene labels: no sequence, and each with its own camera."""

    is_train: NDArray[np.bool_]
    """(N,) for each image, whether the official split trains with it; else it tests."""


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
