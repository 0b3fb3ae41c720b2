"""The protocols that plug-ins implement. ``slam_bof`` uses plug-ins through these alone.

A plug-in is a class that is found by an entry point (see ``registry``). A plug-in with options
declares them as a nested class ``Params`` (a ``slam_bof.types.Params``) and is built as
``Plugin(Plugin.Params(...))``. Data sets are opened by ``open``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    "ContractingBackend",
    "Dataset",
    "DatasetFormat",
    "Descriptor",
    "ForgettingVerifier",
    "LabelledImages",
    "NullObserver",
    "Observer",
    "Odometry",
    "ResumableOdometry",
    "ScaledDataset",
    "Verifier",
]


@runtime_checkable
class Dataset(Protocol):
    """A sequence of depth frames, which are read one at a time."""

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
        """Read the (H, W, 3) RGB image that is registered to the depth image, if there is one."""

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the (H, W) grey image in the frame of the colour camera, if there is one."""

    def groundtruth(self) -> Trajectory | None:
        """Return ``T_world_camera`` of every frame, NaN where unknown; None if all are unknown."""

    def scenes(self) -> tuple[str, ...] | None:
        """Return the true scene label of every frame, or None if they are unknown."""


@runtime_checkable
class ScaledDataset(Protocol):
    """A sequence that knows the unit of its depth images: an optional addition to ``Dataset``.

    Single images of the same camera are then read in the same unit.
    """

    units_per_m: float
    """Units of a depth image per metre, such as 1000 for millimetres."""


@runtime_checkable
class DatasetFormat(Protocol):
    """A format in which sequences are stored. Data-set plug-ins implement this protocol.

    Usually it is the class of its sequences, with ``recognises`` and ``open`` as class methods.
    Such a class may inherit from ``Dataset`` the methods that it does not define.
    """

    @property
    def name(self) -> str:
        """The name under which the format is registered."""

    def recognises(self, path: Path) -> str | bool:
        """Return whether the content of a folder or file is in this format.

        A string names the files that identify the format, such as ``rgb.txt, depth.txt``. It is
        empty if the format does not match.
        """

    def open(self, path: Path) -> Dataset:
        """Open a sequence; raise ``DatasetError`` if something is missing or malformed.

        A format with options (a nested class ``Params``) is opened by ``open(path, params)``.
        """


@runtime_checkable
class LabelledImages(Dataset, Protocol):
    """A data set of single images with scene labels. Each image has its own camera."""

    is_train: NDArray[np.bool_]
    """(N,) whether the official split uses an image for training; it tests with the others."""


@runtime_checkable
class Descriptor(Protocol):
    """Computes descriptors of a frame: many local ones, or one row for the whole frame."""

    needs_gray: ClassVar[bool]
    """Whether it needs the grey image as well as the depth image."""
    is_binary: ClassVar[bool]
    """Whether descriptors are strings of bits, packed in bytes."""
    comparison: ClassVar[str]
    """How frames are compared. ``bag`` is a bag of words for local features, ``hamming`` the share
    of bits that local binary codes have in common with the nearest of the other frame. For one row
    per frame it is ``cosine``, ``l1`` (mean absolute difference) or ``equal`` (share of equal
    values)."""

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[Any]:
        """Return descriptors (M, D), or (M, D / 8) uint8 if binary; M = 0 if there are none."""


@runtime_checkable
class Odometry(Protocol):
    """Tracks the camera from frame to frame."""

    def process(self, frame: DepthFrame) -> Pose:
        """Return ``T_odom_camera``, identity for the first frame; never fail on empty frames."""

    def reset(self) -> None:
        """Return to the initial state; the next frame is the first one."""


@runtime_checkable
class ResumableOdometry(Odometry, Protocol):
    """An odometry whose state can be saved, so that a resumed run need not repeat it."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Return arrays that hold all that the next poses depend on, apart from the frames."""

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state of ``state``: the next poses are the same to the byte.

        ``ValueError`` if it is no state of this odometry with these parameters.
        """


@runtime_checkable
class Verifier(Protocol):
    """Registers two keyframes and decides by geometry whether they show the same place."""

    def prepare(self, frame: DepthFrame, points_camera: Array) -> Any:
        """Return what ``verify`` needs of a keyframe, given its frame and its points (N, 3)."""

    def verify(
        self,
        query: Any,
        matches: Sequence[Any],
        *,
        T_match_query: Array | None = None,
        seed: int = 0,
    ) -> list[Verification]:
        """Register the query with each match, from guesses (n, 4, 4) or, if None, globally."""


@runtime_checkable
class ForgettingVerifier(Verifier, Protocol):
    """A verifier that stores what it prepares and can drop it again.

    This is for temporary queries and for keyframes that the map no longer uses.
    """

    def forget(self, prepared: Any) -> None:
        """Drop data that were prepared; raise ``ValueError`` if they are not stored."""


@runtime_checkable
class Backend(Protocol):
    """A pose graph over keyframes."""

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node, and an odometry factor between it and the node before it.

        At the start of a segment that factor is very weak, because odometry was lost in between.
        """

    def set_odometry(
        self, T_odom_camera: Mapping[int, Pose], relative_sigmas: Array | None
    ) -> None:
        """Replace the odometry factors between nodes; it takes effect in the next ``optimize``.

        Factors between segments stay as they are.

        Parameters
        ----------
        T_odom_camera
            The pose (4, 4) of each node by odometry.
        relative_sigmas
            (2,) standard deviations of the rotation and translation from one keyframe to the next,
            as multiples of that of an average loop; None for those of ``add_keyframe``.
        """

    def move(self, keyframe_ids: NDArray[np.integer[Any]], T: Pose) -> None:
        """Move nodes rigidly by ``T`` (4, 4), given in the map frame, before a loop joins them.

        The nodes form whole segments. Only very weak factors connect them with other nodes.
        """

    def add_loop(self, loop: Loop) -> None:
        """Add a verified edge as a between factor with a robust kernel."""

    def update(self) -> None:
        """Optimise incrementally with the nodes and edges added since the last call."""

    def optimize(self) -> NDArray[np.float64]:
        """Optimise the whole graph until it converges.

        Returns the weight of each loop in [0, 1], in the order in which they were added. Loops
        with a weight below 0.5 contradict the others and were left out.
        """

    def poses(self) -> Array:
        """Return ``T_map_camera`` (n, 4, 4) of the nodes, in the order of their ids."""

    def write_g2o(self, path: Path) -> None:
        """Write the graph as a .g2o file, whose tangent vectors have the translation first."""


@runtime_checkable
class ContractingBackend(Backend, Protocol):
    """A pose graph that can remove nodes, so that it does not grow where nothing is new."""

    def contract(self, anchors: Mapping[int, int], max_edges: int) -> Array:
        """Remove nodes (keys), each of which becomes fixed to another (values).

        What was measured between a removed node and others is composed with its pose at the anchor
        and becomes an edge of the anchor, up to ``max_edges`` for a node. ``optimize`` returns
        weights of all loops ever added; those of removed nodes keep theirs.

        Returns ``T_anchor_node`` (n, 4, 4) of the removed nodes.
        """


@runtime_checkable
class Observer(Protocol):
    """Is notified while frames are processed: a progress bar, a live viewer or a test."""

    def on_start(self, n_frames: int) -> None:
        """Receive the number of frames, before the first one."""

    def on_step(self, frame_index: int, step: Step) -> None:
        """Receive the result of a processed frame."""

    def on_warning(self, message: str) -> None:
        """Receive a warning about a problem that did not stop the run."""


class NullObserver:
    """An observer that does nothing."""

    def on_start(self, n_frames: int) -> None:
        """Do nothing."""

    def on_step(self, frame_index: int, step: Step) -> None:
        """Do nothing."""

    def on_warning(self, message: str) -> None:
        """Do nothing."""
