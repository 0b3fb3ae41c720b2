"""Data types passed between the stages of the pipeline. All are frozen.

Poses are 4x4 float64 matrices named ``T_a_b``: ``p_a = T_a_b @ p_b``. Camera
frames are x right, y down, z forward. Metres, radians and seconds.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, model_validator

__all__ = [
    "LOST",
    "Array",
    "Bag",
    "Candidate",
    "CandidateSource",
    "Contours",
    "Decision",
    "DepthFrame",
    "EdgeKind",
    "FramePose",
    "Intrinsics",
    "Keyframe",
    "KeyframeRecord",
    "Loop",
    "Params",
    "Pose",
    "Scene",
    "Step",
    "SubsampledDepth",
    "Trajectory",
    "Verification",
]

Array = NDArray[np.float64]
Pose = NDArray[np.float64]
"""A rigid transform as a (4, 4) matrix."""

INVALID_DEPTH_MM = 65535
"""Value of a pixel without depth in 7-Scenes files; 0 has the same meaning."""

MIN_FOCAL = 0.05
"""Smallest plausible focal length, as a share of the image's size along the same axis."""
MAX_CENTER = 0.95
"""Largest plausible coordinate of the principal point, as a share of the image's size."""
SAME_CAMERA = 0.005
"""Largest relative difference of the intrinsics of one camera, whose focus may move a little."""

Derived = TypeVar("Derived")

LOST = -1
"""Segment number of frames that were taken while odometry was lost."""


class Params(BaseModel):
    """Base class of all parameters. They are frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    keeps_own_defaults: ClassVar[bool] = False
    """Whether an enclosing model leaves the missing keys to the defaults of this class itself."""

    @model_validator(mode="before")
    @classmethod
    def _keep_nested_defaults(cls, given: Any) -> Any:
        """Complete nested parameters that are given in part with the defaults *of this class*.

        Alignment has other defaults in tracking than in verification. A file that sets one
        number of either must not change the others.
        """
        if not isinstance(given, dict):
            return given
        completed = {
            name: {**field.default.model_dump(), **given[name]}
            for name, field in cls.model_fields.items()
            if isinstance(given.get(name), dict)
            and isinstance(field.default, Params)
            and not field.default.keeps_own_defaults
        }
        return {**given, **completed}


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera: image size, focal lengths and principal point, all in pixels.

    Raises
    ------
    ValueError
        If the numbers cannot be of a camera with such images: a focal length is not positive or
        below 5 % of the image's size (a field of view of more than 168 degrees), or the principal
        point lies outside the image or in the 5 % along its edges.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Convert all numbers to plain ones, and check that they are plausible."""
        for name in ("width", "height"):
            object.__setattr__(self, name, operator.index(getattr(self, name)))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if min(self.width, self.height) < 1:
            raise ValueError(f"found an image of {self.width}x{self.height} pixels, expected some")
        for axis, size, focal, center in (
            ("x", self.width, self.fx, self.cx),
            ("y", self.height, self.fy, self.cy),
        ):
            where = f"for an image of {self.width}x{self.height} pixels"
            low, high = MIN_FOCAL * size, MAX_CENTER * size
            if not low <= focal < math.inf:
                raise ValueError(
                    f"found a focal length f{axis} of {focal:g} px {where}, "
                    f"expected at least {low:g} px"
                )
            if not size - high <= center + 0.5 <= high:
                raise ValueError(
                    f"found the principal point at c{axis} = {center:g} px {where}, expected it "
                    f"between {size - high:g} and {high:g} px"
                )

    def is_close(self, other: Intrinsics) -> bool:
        """Return whether both are of one camera, whose focus may move a little.

        The sizes are equal, the focal lengths differ by no more than 0.5 %, and the principal
        points by no more than 0.5 % of the image's size.
        """
        return (
            (self.width, self.height) == (other.width, other.height)
            and abs(self.fx - other.fx) <= SAME_CAMERA * other.fx
            and abs(self.fy - other.fy) <= SAME_CAMERA * other.fy
            and abs(self.cx - other.cx) <= SAME_CAMERA * other.width
            and abs(self.cy - other.cy) <= SAME_CAMERA * other.height
        )


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrame:
    """One depth image with its time and camera.

    Parameters
    ----------
    stamp_s
        Time in seconds, on any clock that increases.
    depth
        (H, W) depth, either uint16 in millimetres (0 and 65535 mean missing) or float in metres
        (0, negative and non-finite values mean missing).
    intrinsics
        Intrinsics of the depth camera for this image size.

    Raises
    ------
    ValueError
        If the size of the image differs from that of the intrinsics, or its type is neither
        uint16 nor float.
    """

    stamp_s: float
    depth: NDArray[Any]
    intrinsics: Intrinsics
    _derived: dict[Callable[[DepthFrame], Any], Any] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        """Check shape and type once, when the frame is made."""
        expected = (self.intrinsics.height, self.intrinsics.width)
        if self.depth.shape != expected:
            raise ValueError(
                f"depth must be {expected} like its intrinsics, got {self.depth.shape}"
            )
        if self.depth.dtype != np.uint16 and self.depth.dtype.kind != "f":
            raise ValueError(f"depth must be uint16 mm or float m, got {self.depth.dtype}")

    def derive(self, compute: Callable[[DepthFrame], Derived]) -> Derived:
        """Return ``compute(frame)``. The result of the first call is cached in the frame.

        Tracking, recognition and verification all need the same ``DepthView`` of a frame.
        """
        if compute not in self._derived:
            self._derived[compute] = compute(self)
        derived: Derived = self._derived[compute]
        return derived

    def depth_m(self, stride: int = 1) -> NDArray[np.float32]:
        """Return the depth of every ``stride``-th pixel in metres, 0 where it is missing."""
        depth = np.ascontiguousarray(self.depth[::stride, ::stride])
        if depth.dtype == np.uint16:
            metres = depth * np.float32(0.001)
            metres[depth == INVALID_DEPTH_MM] = 0.0
            return metres
        valid = np.isfinite(depth) & (depth > 0)
        return np.where(valid, depth, 0.0).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Contours:
    """The closed contours of one frame's layer images.

    ``points_px[i]`` is an (M_i, 2) int32 array with the (x, y) corners of a closed polygon in
    order. It was found in layer ``layer[i]``; ``layer`` is (C,) int32.
    """

    points_px: tuple[NDArray[np.int32], ...]
    layer: NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of contours."""
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """A sparse bag of visual words: sorted distinct words and their L1-normalised weights.

    ``words`` is (W,) int32. ``weights`` is (W,) float32, positive, and sums to 1. Both are empty
    for a frame without features.
    """

    words: NDArray[np.int32]
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene label, and the probabilities (C,) of all classes in the order of ``classes``."""

    label: str
    probability: float
    classes: tuple[str, ...]
    probabilities: Array


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A frame that the map keeps.

    ``id`` counts keyframes and ``frame_index`` counts frames. ``T_odom_camera`` and ``segment``
    are defined in ``tracking.Track``. ``scene`` is the label of this keyframe alone; ``smoothed``
    also takes the keyframes before it into account. ``session`` is the number of the run, from 0,
    that the keyframe comes from: a map may hold several runs, each with its own frames and
    odometry.
    """

    id: int
    frame_index: int
    stamp_s: float
    T_odom_camera: Pose
    bag: Bag
    scene: Scene | None
    segment: int = 0
    smoothed: Scene | None = None
    session: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """The result of registering a pair of keyframes.

    ``overlap`` is the share of the query's points that have a corresponding point in the match,
    and ``rmse_m`` is their point-to-plane error. ``information`` (6, 6) is that of the tangent of
    ``T_match_query``, rotation first (the convention of GTSAM). ``reason`` says in words why
    ``accepted`` is false.
    """

    accepted: bool
    reason: str
    T_match_query: Pose
    overlap: float
    rmse_m: float
    information: Array


class CandidateSource(StrEnum):
    """The method that proposed a pair of keyframes."""

    VIEW = "view"
    """Place recognition by depth views."""
    BAG = "bag"
    """Place recognition by bags of BOF words, as in the paper."""
    PROXIMITY = "proximity"
    """The poses of the map: according to them both keyframes see the same surfaces."""
    PRUNED = "pruned"
    """Pruning: the edge replaces keyframes that were removed between the two."""


class EdgeKind(StrEnum):
    """The kind of an edge between two keyframes."""

    LOOP = "loop"
    """A revisit: the two are far apart in time and passed all checks for loops."""
    COVISIBILITY = "covisibility"
    """Two neighbours in time or in the map that see the same surfaces."""


class Decision(StrEnum):
    """The decision about a candidate."""

    OPEN = ""
    """Not decided yet."""
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    HELD = "held"
    """Verified by geometry. It enters the graph when other loops agree with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One line of the audit trail: a pair of keyframes that was considered as an edge.

    ``reason`` explains the decision in words. It is empty if the pair passed every check.
    """

    query_id: int
    match_id: int
    source: CandidateSource
    kind: EdgeKind = EdgeKind.LOOP
    score: float = float("nan")
    normaliser: float = float("nan")
    eta: float = float("nan")
    scene_agreement: float = float("nan")
    n_consistent: int = 0
    overlap: float = float("nan")
    rmse_m: float = float("nan")
    decision: Decision = Decision.OPEN
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A verified edge of the pose graph between two keyframes.

    ``information`` (6, 6) is that of the tangent of ``T_match_query``, rotation first.
    """

    query_id: int
    match_id: int
    T_match_query: Pose
    information: Array
    kind: EdgeKind
    source: CandidateSource


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """The poses (4, 4) of a frame from odometry (``T_odom_raw``) and after tracking.

    ``segment`` is the number of the uninterrupted track that the frame belongs to, or ``LOST``
    while odometry was lost. ``T_view_camera`` is the pose of the sensor in the virtual camera that
    its point cloud was projected into, and None for a depth image.
    """

    stamp_s: float
    T_odom_raw: Pose
    T_odom_camera: Pose
    segment: int
    T_view_camera: Pose | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SubsampledDepth:
    """The pixels of a depth image that the map keeps, chosen by ``geometry.subsample``.

    ``depth`` is (h, w) uint16 in steps of 1 / ``per_m`` metres, 0 where missing. ``intrinsics``
    are those of the full image.
    """

    depth: NDArray[np.uint16]
    per_m: int
    intrinsics: Intrinsics


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeRecord:
    """Everything that is saved with a keyframe, enough to resume the run after it.

    ``frames`` are the frames after the keyframe before, up to and including this one.
    ``measured`` are the loops of this keyframe that geometry verified. ``admitted`` are the loops
    that entered the graph with it, in that order: some of ``measured`` may be missing, and held
    loops of earlier keyframes may be among them. ``state`` is the remaining state of the plug-in
    as JSON values.
    """

    keyframe: Keyframe
    depth: SubsampledDepth
    frames: tuple[FramePose, ...]
    candidates: tuple[Candidate, ...]
    measured: tuple[Loop, ...]
    admitted: tuple[Loop, ...]
    state: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The result of processing one frame.

    ``keyframe`` is None if the frame did not become one. ``scene`` is the latest label. ``loops``
    are the edges that were accepted with this frame, and ``candidates`` are all pairs that were
    considered for them. ``T_map_odom`` corrects the odometry frame (REP 105):
    ``T_map_camera = T_map_odom @ T_odom_camera``. If ``is_lost`` is true, the odometry pose is
    wrong and no better one is known.
    """

    keyframe: Keyframe | None
    scene: Scene | None
    loops: tuple[Loop, ...]
    candidates: tuple[Candidate, ...]
    T_map_odom: Pose
    is_lost: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Time stamps (N,) in seconds, and the poses ``T_world_camera`` (N, 4, 4) at these times."""

    stamps_s: Array = field(default_factory=lambda: np.empty(0))
    poses: Array = field(default_factory=lambda: np.empty((0, 4, 4)))

    def __post_init__(self) -> None:
        """Check that there is one pose per time stamp."""
        if self.poses.shape != (len(self.stamps_s), 4, 4):
            raise ValueError(f"poses must be ({len(self.stamps_s)}, 4, 4), got {self.poses.shape}")

    def __repr__(self) -> str:
        """Return how many poses there are, and from when to when."""
        if not len(self):
            return "Trajectory(no poses)"
        first_s, last_s = self.stamps_s[[0, -1]].tolist()
        return f"Trajectory({len(self)} poses from {first_s} to {last_s} s)"

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_s)
