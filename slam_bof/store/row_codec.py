"""Records to rows of ``map.db`` and back (see ``schema``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.geometry import se3
from slam_bof.scenes import Region
from slam_bof.store.schema import BOX, POSE, SMOOTHED
from slam_bof.types import (
    Bag,
    Candidate,
    FramePose,
    Intrinsics,
    Keyframe,
    Loop,
    Pose,
    Scene,
    ThinDepth,
)

__all__ = [
    "INSERT_CANDIDATE",
    "INSERT_FRAME",
    "INSERT_KEYFRAME",
    "INSERT_REGION",
    "INSERT_VIEW",
    "candidate_of",
    "candidate_row",
    "edge_row",
    "frame_of",
    "frame_row",
    "keyframe_of",
    "keyframe_row",
    "loop_of",
    "pose_of",
    "pose_row",
    "region_of",
    "region_row",
    "scene_of",
    "scene_row",
    "smoothed_of",
    "thin_of",
    "view_row",
]

Row = Sequence[Any]
CANDIDATE = tuple(field.name for field in fields(Candidate))
EDGE = (*POSE, "information", "loop_id", "admitted_by")
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 3]
"""Of a view at 160 x 120: some 13 kB in 1 ms; the slowest would save a tenth."""


def _insert(table: str, columns: Sequence[str]) -> str:
    return f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"


INSERT_KEYFRAME = _insert(
    "keyframes",
    [
        *("id", "session", "frame_index", "stamp_s", "segment"),
        *(f"odom_{name}" for name in POSE),
        *("scene", "scene_probability", "probabilities", "words", "weights"),
        *list(SMOOTHED)[:3],
    ],
)
INSERT_VIEW = _insert("views", ["keyframe_id", "per_m", "depth"])
INSERT_FRAME = _insert(
    "frames",
    [
        *("session", "frame_index", "stamp_s", "segment"),
        *("T_odom_raw", "T_odom_camera", "T_view_camera"),
    ],
)
INSERT_CANDIDATE = _insert("candidates", [*CANDIDATE, *EDGE])
INSERT_REGION = _insert("regions", ["id", "label", "probability", "n_keyframes", *BOX])


def keyframe_row(keyframe: Keyframe) -> Row:
    """Return the values of ``INSERT_KEYFRAME``."""
    return (
        int(keyframe.id),
        int(keyframe.session),
        int(keyframe.frame_index),
        float(keyframe.stamp_s),
        int(keyframe.segment),
        *pose_row(keyframe.T_odom_camera),
        *scene_row(keyframe.scene),
        _blob(keyframe.bag.words, "<i4"),
        _blob(keyframe.bag.weights, "<f4"),
        *scene_row(keyframe.smoothed),
    )


def keyframe_of(row: Any, classes: tuple[str, ...]) -> Keyframe:
    """Return the keyframe in a row of ``keyframes``."""
    return Keyframe(
        row["id"],
        row["frame_index"],
        row["stamp_s"],
        pose_of(row, "odom_"),
        Bag(_array(row["words"], "<i4"), _array(row["weights"], "<f4")),
        scene_of(row, classes),
        row["segment"],
        smoothed_of(row, classes),
        row["session"],
    )


def scene_of(row: Any, classes: tuple[str, ...]) -> Scene | None:
    """Return the label in a row of ``keyframes``, if it has one."""
    return _scene(row, ("scene", "scene_probability", "probabilities"), classes)


def smoothed_of(row: Any, classes: tuple[str, ...]) -> Scene | None:
    """Return the smoothed label in a row of ``keyframes``, if it has one."""
    return _scene(row, tuple(SMOOTHED)[:3], classes)


def scene_row(scene: Scene | None) -> Row:
    """Return label, probability and probabilities, null where there is no label."""
    if scene is None:
        return None, None, None
    return scene.label, float(scene.probability), _blob(scene.probabilities, "<f8")


def region_row(region: Region) -> Row:
    """Return the values of ``INSERT_REGION``."""
    box = (*region.center_m, *region.low_m, *region.high_m)
    return (region.id, region.label, region.probability, len(region.keyframe_ids), *box)


def region_of(row: Any, keyframe_ids: Sequence[int]) -> Region:
    """Return the region in a row of ``regions``."""
    values = [row[name] for name in BOX]
    center_m, low_m, high_m = ((values[k], values[k + 1], values[k + 2]) for k in (0, 3, 6))
    return Region(
        row["id"], row["label"], row["probability"], tuple(keyframe_ids), center_m, low_m, high_m
    )


def view_row(keyframe_id: int, thin: ThinDepth) -> Row:
    """Return the values of ``INSERT_VIEW``."""
    _, png = cv2.imencode(".png", thin.depth, PNG)
    return int(keyframe_id), thin.per_m, png.tobytes()


def thin_of(row: Any, camera: Intrinsics) -> ThinDepth | None:
    """Return what is kept of a depth image in a row of ``views``, nothing if it is damaged."""
    png = np.frombuffer(row["depth"], np.uint8)
    depth = cv2.imdecode(png, cv2.IMREAD_UNCHANGED) if png.size else None
    if depth is None or depth.dtype != np.uint16 or depth.ndim != 2:
        return None
    return ThinDepth(np.asarray(depth, np.uint16), row["per_m"], camera)


POSE_BYTES = 12 * 8
"""Of a pose's blob; a keyframe's is followed by its covariance, (6, 6)."""


def frame_row(session: int, frame_index: int, frame: FramePose) -> Row:
    """Return the values of ``INSERT_FRAME``."""
    view = None if frame.T_view_camera is None else _blob(frame.T_view_camera[:3], "<f8")
    pose = _blob(frame.T_odom_camera[:3], "<f8")
    if frame.covariance is not None:
        pose += _blob(frame.covariance, "<f8")
    poses = (_blob(frame.T_odom_raw[:3], "<f8"), pose, view)
    return (session, int(frame_index), float(frame.stamp_s), int(frame.segment), *poses)


def frame_of(row: Any) -> FramePose:
    """Return the frame in a row of ``frames``."""
    view = row["T_view_camera"]
    covariance = row["T_odom_camera"][POSE_BYTES:]
    return FramePose(
        row["stamp_s"],
        _whole(row["T_odom_raw"]),
        _whole(row["T_odom_camera"][:POSE_BYTES]),
        row["segment"],
        None if view is None else _whole(view),
        np.frombuffer(covariance, "<f8").reshape(6, 6) if covariance else None,
    )


def candidate_row(candidate: Candidate, edge: Row) -> Row:
    """Return the values of ``INSERT_CANDIDATE``; SQLite keeps NaN as null."""
    values = (getattr(candidate, name) for name in CANDIDATE)
    own = [value.item() if isinstance(value, np.generic) else value for value in values]
    return (*own, *edge)


def edge_row(
    loop: Loop | None, *, loop_id: int | None = None, admitted_by: int | None = None
) -> Row:
    """Return the values of ``INSERT_CANDIDATE`` that are of the edge, null where there is none."""
    if loop is None:
        return (None,) * len(EDGE)
    information = _blob(loop.information, "<f8")
    return (*pose_row(loop.T_match_query), information, loop_id, admitted_by)


def candidate_of(row: Any) -> Candidate:
    """Return the candidate in a row of ``candidates``."""
    values: dict[str, Any] = {name: row[name] for name in CANDIDATE}
    values |= {name: math.nan for name, value in values.items() if value is None}
    return Candidate(**values)


def loop_of(row: Any) -> Loop:
    """Return the edge in a row of ``loops``, or in one of ``candidates`` that has one."""
    information = _array(row["information"], "<f8").reshape(6, 6)
    ids = (row["query_id"], row["match_id"])
    return Loop(*ids, pose_of(row), information, row["kind"], row["source"])


def pose_row(T: Pose) -> list[float]:
    """Return tx ty tz qx qy qz qw of a pose (4, 4)."""
    return [*T[:3, 3].tolist(), *se3.to_quaternion(T).tolist()]


def pose_of(row: Any, prefix: str = "") -> Pose:
    """Return the pose (4, 4) in the columns ``<prefix>tx ... <prefix>qw``."""
    t, quaternion = ([row[prefix + name] for name in part] for part in (POSE[:3], POSE[3:]))
    return se3.from_quaternion(quaternion, t)


def _scene(row: Any, columns: Sequence[str], classes: tuple[str, ...]) -> Scene | None:
    label, probability, probabilities = (row[name] for name in columns)
    if label is None:
        return None
    return Scene(label, probability, classes, _array(probabilities, "<f8"))


def _blob(values: ArrayLike, dtype: str) -> bytes:
    return np.asarray(values).astype(dtype).tobytes()


def _array(blob: bytes, dtype: str) -> NDArray[Any]:
    return np.frombuffer(blob, dtype)


def _whole(blob: bytes) -> Pose:
    """Return the pose (4, 4) of which the first three rows are given."""
    return np.vstack([_array(blob, "<f8").reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
