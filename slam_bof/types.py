"""The records that travel between the stages, all frozen.

Poses are 4x4 float64 matrices named ``T_a_b``: ``p_a = T_a_b @ p_b``. Camera
frames are x right, y down, z forward. Metres, radians and seconds.
"""

from __future__ import annotations

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
"""What 7-Scenes writes, besides 0, where the sensor saw nothing."""

Derived = TypeVar("Derived")

LOST = -1
"""In place of a segment, of frames while odometry was lost."""


class Params(BaseModel):
    """Base of every part's parameters: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    given_whole: ClassVar[bool] = False
    """Whether, as a part of others, it is never completed by their defaults."""

    @model_validator(mode="before")
    @classmethod
    def _keep_the_defaults_of_parts(cls, given: Any) -> Any:
        """Complete a part given by some of its keys with what the others are by default *here*.

        Alignment has other defaults in tracking than in verification; a file that sets one
        number of either must not change the rest.
        """
        if not isinstance(given, dict):
            return given
        parts = {
            name: {**field.default.model_dump(), **given[name]}
            for name, field in cls.model_fields.items()
            if isinstance(given.get(name), dict)
            and isinstance(field.default, Params)
            and not field.default.given_whole
        }
        return {**given, **parts}


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera: focal lengths and principal point in pixels, image size."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrame:
    """One depth image with its time and camera.

    Parameters
    ----------
    stamp_s
        Time in seconds, on any clock that grows.
    depth
        (H, W), either uint16 millimetres (0 and 65535 missing) or float metres
        (0, negative and non-finite missing).
    intrinsics
        Of the depth camera, for this image size.

    Raises
    ------
    ValueError
        If the image is not (H, W) as the intrinsics say, or of another type.
    """

    stamp_s: float
    depth: NDArray[Any]
    intrinsics: Intrinsics
    _derived: dict[Callable[[DepthFrame], Any], Any] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        """Check shape and type, once, where the image enters."""
        expected = (self.intrinsics.height, self.intrinsics.width)
        if self.depth.shape != expected:
            raise ValueError(f"depth must be {expected} as its intrinsics, got {self.depth.shape}")
        if self.depth.dtype != np.uint16 and self.depth.dtype.kind != "f":
            raise ValueError(f"depth must be uint16 mm or float m, got {self.depth.dtype}")

    def derive(self, compute: Callable[[DepthFrame], Derived]) -> Derived:
        """Return ``compute(frame)``, computed at the first call and kept with the frame.

        Tracking, recognition and verification each need the small view of the same frame.
        """
        if compute not in self._derived:
            self._derived[compute] = compute(self)
        derived: Derived = self._derived[compute]
        return derived

    def depth_m(self, stride: int = 1) -> NDArray[np.float32]:
        """Return every ``stride``-th pixel's depth in metres, 0 where it is missing."""
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

    ``points_px[i]`` is an (M_i, 2) int32 array of the (x, y) corners of a closed polygon, in
    order, found in layer ``layer[i]``; ``layer`` is (C,) int32.
    """

    points_px: tuple[NDArray[np.int32], ...]
    layer: NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of contours."""
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """A sparse bag of visual words: sorted distinct words and their L1-normalised weights.

    ``words`` is (W,) int32, ``weights`` (W,) float32, positive, summing to 1 (or both
    empty, for a frame that shows nothing).
    """

    words: NDArray[np.int32]
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene label with the probability of each class, (C,), in ``classes`` order."""

    label: str
    probability: float
    classes: tuple[str, ...]
    probabilities: Array


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A frame that the map keeps: ids count keyframes, ``frame_index`` counts frames.

    ``T_odom_camera`` and ``segment`` are as ``tracking.Track`` has them. ``scene`` is what this
    keyframe alone shows, ``smoothed`` what is likely by the keyframes before it as well.
    ``session`` counts the runs that the map is of; frames and odometry are those of one.
    ``step_covariance`` (6, 6) is of the step from the keyframe before, in the tangent of the pose,
    rotation first, rad and m; None where nothing is known of it.
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
    step_covariance: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """What geometry says of a pair of point clouds.

    ``overlap`` is the share of the query's points with a match nearby, ``rmse_m`` their
    point-to-plane error, ``information`` (6, 6) is for the tangent of ``T_match_query``,
    rotation first, as GTSAM has it, in 1/rad^2 and 1/m^2: the inverse of the covariance of its
    error, next to nothing along directions that the surfaces leave open. ``reason`` says in words
    why ``accepted`` is false.
    """

    accepted: bool
    reason: str
    T_match_query: Pose
    overlap: float
    rmse_m: float
    information: Array


class CandidateSource(StrEnum):
    """What proposed a pair of keyframes."""

    VIEW = "view"
    """Place recognition by depth views."""
    BAG = "bag"
    """Place recognition by bags of BOF words, as in the paper."""
    PROXIMITY = "proximity"
    """The map: by its poses the two keyframes look at the same surfaces."""
    PRUNED = "pruned"
    """Pruning: the edge stands for keyframes that were removed between the two."""


class EdgeKind(StrEnum):
    """What an edge between two keyframes claims."""

    LOOP = "loop"
    """The camera came back: the two are far apart in time, and passed all checks for loops."""
    PARTIAL = "partial"
    """As a loop, but the surfaces that both see leave directions open, which it does not hold."""
    COVISIBILITY = "covisibility"
    """Neighbours, in time or in the map, that see the same surfaces."""


class Decision(StrEnum):
    """What became of a candidate."""

    OPEN = ""
    """Not decided yet."""
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    HELD = "held"
    """Verified by geometry, and waiting for other loops to agree."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One line of the audit trail: a pair of keyframes that was considered as an edge.

    ``reason`` says in words why the decision is what it is; it is empty where the pair passed
    every check.
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

    ``information`` (6, 6) is that of the tangent of ``T_match_query``, rotation first, as in
    ``Verification``.
    """

    query_id: int
    match_id: int
    T_match_query: Pose
    information: Array
    kind: EdgeKind
    source: CandidateSource


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """Where odometry had a frame, and where tracking has it, both (4, 4).

    ``segment`` is the uninterrupted track it is of, ``LOST`` while odometry was lost.
    ``T_view_camera`` is how the sensor stood in the view that was cut of its point cloud, None for
    a depth image. ``covariance`` (6, 6) of a keyframe is as ``Keyframe.step_covariance``.
    """

    stamp_s: float
    T_odom_raw: Pose
    T_odom_camera: Pose
    segment: int
    T_view_camera: Pose | None = None
    covariance: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SubsampledDepth:
    """The pixels of a depth image that the map keeps, chosen by ``geometry.subsample``.

    ``depth`` is (h, w) uint16 in steps of which ``per_m`` make a metre, 0 where missing;
    ``intrinsics`` are those of the whole image.
    """

    depth: NDArray[np.uint16]
    per_m: int
    intrinsics: Intrinsics


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeRecord:
    """All that the map learns with a keyframe, and all that it takes to go on from there.

    ``frames`` are those since the keyframe before, this one the last of them. ``measured`` are
    its own loops that geometry verified, ``admitted`` those that entered the graph with it, in
    that order: of its own not all, of earlier keyframes some that were held back. ``state`` is what
    else the plug-in remembers, as JSON has it.
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
    """The answer to one frame.

    ``keyframe`` is None where the frame was not made one; ``scene`` is the latest label;
    ``loops`` are the edges accepted just now, ``candidates`` all that were considered for
    them; ``T_map_odom`` corrects the odometry frame, as REP-105 has it:
    ``T_map_camera = T_map_odom @ T_odom_camera``. ``health`` is ``tracked``, ``degenerate`` where
    the surfaces in sight leave ``open_axes`` (6, k) to odometry alone (directions in the camera's
    frame: a turn in rad, then metres), or ``lost``, also ``is_lost``: the odometry cannot be right,
    and nothing better is known. ``covariance`` (6, 6) is of the pose since the last keyframe.
    """

    keyframe: Keyframe | None
    scene: Scene | None
    loops: tuple[Loop, ...]
    candidates: tuple[Candidate, ...]
    T_map_odom: Pose
    is_lost: bool = False
    open_axes: Array = field(default_factory=lambda: np.empty((6, 0)))
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))

    @property
    def health(self) -> str:
        """Return ``tracked``, ``degenerate`` or ``lost``."""
        if self.is_lost:
            return "lost"
        return "degenerate" if self.open_axes.shape[1] else "tracked"


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Stamps (N,) in seconds, and the poses (N, 4, 4) ``T_world_camera`` at them."""

    stamps_s: Array = field(default_factory=lambda: np.empty(0))
    poses: Array = field(default_factory=lambda: np.empty((0, 4, 4)))

    def __post_init__(self) -> None:
        """Check that there is one pose for each stamp."""
        if self.poses.shape != (len(self.stamps_s), 4, 4):
            raise ValueError(f"poses must be ({len(self.stamps_s)}, 4, 4), got {self.poses.shape}")

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_s)
