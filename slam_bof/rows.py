"""Records to rows of ``map.db`` and back (see ``schema``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof import se3
from slam_bof.regions import Region
from slam_bof.schema import BOX, POSE, SMOOTHED
from slam_bof.types import Array, Bag, Candidate, Keyframe, Loop, Pose, Scene

__all__ = [
    "INSERT_CANDIDATE",
    "INSERT_KEYFRAME",
    "INSERT_LOOP",
    "INSERT_REGION",
    "candidate_of",
    "candidate_row",
    "cloud_of",
    "keyframe_of",
    "keyframe_row",
    "loop_of",
    "loop_row",
    "pose_of",
    "pose_row",
    "region_of",
    "region_row",
    "scene_of",
    "scene_row",
    "smoothed_of",
]

Row = Sequence[Any]
CANDIDATE = tuple(field.name for field in fields(Candidate))


def _insert(table: str, columns: Sequence[str]) -> str:
    return f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"


INSERT_KEYFRAME = _insert(
    "keyframes",
    [
        *("id", "frame_index", "stamp_s", "segment"),
        *(f"odom_{name}" for name in POSE),
        *("scene", "scene_probability", "probabilities", "words", "weights", "cloud"),
        *list(SMOOTHED)[:3],
    ],
)
INSERT_CANDIDATE = _insert("candidates", CANDIDATE)
INSERT_LOOP = _insert("loops", ["query_id", "match_id", "kind", "source", *POSE, "information"])
INSERT_REGION = _insert("regions", ["id", "label", "probability", "n_keyframes", *BOX])


def keyframe_row(keyframe: Keyframe, cloud: Array | None) -> Row:
    """Return the values of ``INSERT_KEYFRAME``; ``cloud`` is (N, 3) points_camera."""
    return (
        int(keyframe.id),
        int(keyframe.frame_index),
        float(keyframe.stamp_s),
        int(keyframe.segment),
        *pose_row(keyframe.T_odom_camera),
        *scene_row(keyframe.scene),
        _blob(keyframe.bag.words, "<i4"),
        _blob(keyframe.bag.weights, "<f4"),
        None if cloud is None else _blob(cloud, "<f4"),
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


def cloud_of(row: Any) -> Array | None:
    """Return the (N, 3) points_camera in a row of ``keyframes``, if there are any."""
    if row["cloud"] is None:
        return None
    return _array(row["cloud"], "<f4").reshape(-1, 3).astype(np.float64)


def candidate_row(candidate: Candidate) -> Row:
    """Return the values of ``INSERT_CANDIDATE``; SQLite keeps NaN as null."""
    values = (getattr(candidate, name) for name in CANDIDATE)
    return [value.item() if isinstance(value, np.generic) else value for value in values]


def candidate_of(row: Any) -> Candidate:
    """Return the candidate in a row of ``candidates``."""
    values: dict[str, Any] = {name: row[name] for name in CANDIDATE}
    values |= {name: math.nan for name, value in values.items() if value is None}
    return Candidate(**values)


def loop_row(loop: Loop) -> Row:
    """Return the values of ``INSERT_LOOP``."""
    information = _blob(loop.information, "<f8")
    ids = (int(loop.query_id), int(loop.match_id))
    return (*ids, loop.kind, loop.source, *pose_row(loop.T_match_query), information)


def loop_of(row: Any) -> Loop:
    """Return the edge in a row of ``loops``."""
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
