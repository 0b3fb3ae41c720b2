"""Row codec: records encoded as rows of ``map.db`` (see ``schema``), and decoded from them."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.core import decode_image, parse_npy
from slam_bof.geometry import se3, view_stride
from slam_bof.scenes import MapRoom
from slam_bof.store.row_checks import POSE_BYTES, SKIPPED, STATE
from slam_bof.store.schema import BOX_COLUMNS, POSE_COLUMNS, SMOOTHED_COLUMNS
from slam_bof.types import (
    Bag,
    Candidate,
    CandidateSource,
    Decision,
    EdgeKind,
    FramePose,
    Intrinsics,
    Keyframe,
    Loop,
    OdometryState,
    Pose,
    SavedConstellation,
    Scene,
    SubsampledDepth,
)

__all__ = [
    "INSERT_CANDIDATE",
    "INSERT_CONSTELLATION",
    "INSERT_FRAME",
    "INSERT_KEYFRAME",
    "INSERT_ODOMETRY",
    "INSERT_REGION",
    "INSERT_VIEW",
    "decode_candidate",
    "decode_constellation",
    "decode_frame",
    "decode_keyframe",
    "decode_loop",
    "decode_odometry",
    "decode_pose",
    "decode_room",
    "decode_scene",
    "decode_smoothed_scene",
    "decode_view",
    "encode_candidate",
    "encode_constellation",
    "encode_edge",
    "encode_frame",
    "encode_keyframe",
    "encode_odometry",
    "encode_pose",
    "encode_room",
    "encode_scene",
    "encode_view",
]

Row = Sequence[Any]
CANDIDATE_COLUMNS = tuple(field.name for field in fields(Candidate))
EDGE_COLUMNS = (*POSE_COLUMNS, "information", "loop_id", "admitted_by")
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 3]
"""A depth image of 160 x 120 takes about 13 kB and 1 ms; the highest level saves a tenth."""


def _insert(table: str, columns: Sequence[str]) -> str:
    return f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({', '.join('?' * len(columns))})"


INSERT_KEYFRAME = _insert(
    "keyframes",
    [
        *("id", "session", "frame_index", "stamp_s", "segment"),
        *(f"odom_{name}" for name in POSE_COLUMNS),
        *("scene", "scene_probability", "probabilities", "words", "weights"),
        *list(SMOOTHED_COLUMNS)[:3],
    ],
)
INSERT_VIEW = _insert("views", ["keyframe_id", "per_m", "depth"])
INSERT_CONSTELLATION = _insert(
    "constellations", ["keyframe_id", "gravity", "describer", "contours", "weight"]
)
INSERT_FRAME = _insert(
    "frames",
    [
        *("session", "frame_index", "stamp_s", "segment"),
        *("T_odom_raw", "T_odom_camera", "T_view_camera"),
    ],
)
INSERT_CANDIDATE = _insert("candidates", [*CANDIDATE_COLUMNS, *EDGE_COLUMNS])
INSERT_ODOMETRY = _insert("odometry", ["name", "session", "frame_index", "value"])
INSERT_REGION = _insert("regions", ["id", "label", "probability", "n_keyframes", *BOX_COLUMNS])


def encode_keyframe(keyframe: Keyframe) -> Row:
    """Return the values of ``INSERT_KEYFRAME``."""
    return (
        int(keyframe.id),
        int(keyframe.session),
        int(keyframe.frame_index),
        float(keyframe.stamp_s),
        int(keyframe.segment),
        *encode_pose(keyframe.T_odom_camera),
        *encode_scene(keyframe.scene),
        _to_blob(keyframe.bag.words, "<i4"),
        _to_blob(keyframe.bag.weights, "<f4"),
        *encode_scene(keyframe.smoothed),
    )


def decode_keyframe(row: Any, classes: tuple[str, ...]) -> Keyframe:
    """Return the keyframe in a row of ``keyframes``."""
    return Keyframe(
        id=row["id"],
        frame_index=row["frame_index"],
        stamp_s=row["stamp_s"],
        T_odom_camera=decode_pose(row, "odom_"),
        bag=Bag(_from_blob(row["words"], "<i4"), _from_blob(row["weights"], "<f4")),
        scene=decode_scene(row, classes),
        segment=row["segment"],
        smoothed=decode_smoothed_scene(row, classes),
        session=row["session"],
    )


def decode_scene(row: Any, classes: tuple[str, ...]) -> Scene | None:
    """Return the label of the image alone in a row of ``keyframes``, None if it has none."""
    return _scene(row, ("scene", "scene_probability", "probabilities"), classes)


def decode_smoothed_scene(row: Any, classes: tuple[str, ...]) -> Scene | None:
    """Return the smoothed label in a row of ``keyframes``, None if it has none."""
    return _scene(row, tuple(SMOOTHED_COLUMNS)[:3], classes)


def encode_scene(scene: Scene | None) -> Row:
    """Return label, probability and probabilities, None where there is no label."""
    if scene is None:
        return None, None, None
    return scene.label, float(scene.probability), _to_blob(scene.probabilities, "<f8")


def encode_room(room: MapRoom) -> Row:
    """Return the values of ``INSERT_REGION``."""
    box = (*room.center_m, *room.low_m, *room.high_m)
    return (room.id, room.label, room.probability, len(room.keyframe_ids), *box)


def decode_room(row: Any, keyframe_ids: Sequence[int]) -> MapRoom:
    """Return the room in a row of ``regions``."""
    values = [row[name] for name in BOX_COLUMNS]
    center_m, low_m, high_m = ((values[k], values[k + 1], values[k + 2]) for k in (0, 3, 6))
    return MapRoom(
        id=row["id"],
        label=row["label"],
        probability=row["probability"],
        keyframe_ids=tuple(keyframe_ids),
        center_m=center_m,
        low_m=low_m,
        high_m=high_m,
    )


def encode_view(keyframe_id: int, depth: SubsampledDepth) -> Row:
    """Return the values of ``INSERT_VIEW``."""
    _, png = cv2.imencode(".png", depth.depth, PNG)
    return int(keyframe_id), depth.per_m, png.tobytes()


def decode_view(row: Any, camera: Intrinsics) -> SubsampledDepth | None:
    """Return the subsampled depth image in a row of ``views``, None if it is damaged."""
    stride = view_stride(camera)
    size = (-(-camera.width // stride), -(-camera.height // stride))
    is_blob = isinstance(row["depth"], bytes)  # not where a page of the database is broken
    # The header is read first: a few bytes may stand for an image of gigabytes.
    if not is_blob or row["depth"][16:24] != struct.pack(">2I", *size):
        return None
    depth = decode_image(row["depth"])
    if depth is None or depth.dtype != np.uint16 or depth.shape != size[::-1]:
        return None
    return SubsampledDepth(np.asarray(depth, np.uint16), row["per_m"], camera)


def encode_constellation(keyframe_id: int, saved: SavedConstellation) -> Row:
    """Return the values of ``INSERT_CONSTELLATION``."""
    gravity = _to_blob(saved.gravity_camera, "<f8")
    return int(keyframe_id), gravity, saved.describer, saved.contours, saved.weight


def decode_constellation(row: Any) -> SavedConstellation:
    """Return the constellation in a row of ``constellations``."""
    gravity_camera = _from_blob(row["gravity"], "<f8")
    return SavedConstellation(gravity_camera, row["describer"], row["contours"], row["weight"])


def encode_frame(session: int, frame_index: int, frame: FramePose) -> Row:
    """Return the values of ``INSERT_FRAME``."""
    view = None if frame.T_view_camera is None else _to_blob(frame.T_view_camera[:3], "<f8")
    pose = _to_blob(frame.T_odom_camera[:3], "<f8")
    if frame.step_covariance is not None:
        pose += _to_blob(frame.step_covariance, "<f8")
    poses = (_to_blob(frame.T_odom_raw[:3], "<f8"), pose, view)
    return (session, int(frame_index), float(frame.stamp_s), int(frame.segment), *poses)


def decode_frame(row: Any) -> FramePose:
    """Return the frame in a row of ``frames``.

    The pose of a keyframe may be followed by the covariance of its step.
    """
    view = row["T_view_camera"]
    covariance = row["T_odom_camera"][POSE_BYTES:]
    return FramePose(
        stamp_s=row["stamp_s"],
        T_odom_raw=_pose_of_3x4(row["T_odom_raw"]),
        T_odom_camera=_pose_of_3x4(row["T_odom_camera"][:POSE_BYTES]),
        segment=row["segment"],
        T_view_camera=None if view is None else _pose_of_3x4(view),
        step_covariance=_from_blob(covariance, "<f8").reshape(6, 6) if covariance else None,
    )


def encode_odometry(session: int, state: OdometryState) -> list[Row]:
    """Return the values of ``INSERT_ODOMETRY``, a row for each array."""
    arrays = {SKIPPED: state.skipped} | {STATE + name: a for name, a in state.arrays.items()}
    at = (int(session), int(state.frame_index))
    return [(name, *at, _to_npy(array)) for name, array in arrays.items()]


def decode_odometry(rows: Sequence[Any]) -> OdometryState | None:
    """Return the state in the rows of a session; None if there are none, or not of one frame."""
    arrays = {row["name"]: parse_npy(row["value"]) for row in rows}
    skipped = arrays.pop(SKIPPED, None)
    at = {row["frame_index"] for row in rows}
    if skipped is None or len(at) != 1:
        return None
    return OdometryState(at.pop(), skipped, {n.removeprefix(STATE): a for n, a in arrays.items()})


def encode_candidate(candidate: Candidate, edge: Row) -> Row:
    """Return the values of ``INSERT_CANDIDATE``; SQLite stores NaN as null."""
    values = (getattr(candidate, name) for name in CANDIDATE_COLUMNS)
    own = [value.item() if isinstance(value, np.generic) else value for value in values]
    return (*own, *edge)


def encode_edge(
    loop: Loop | None, *, loop_id: int | None = None, admitted_by: int | None = None
) -> Row:
    """Return the values of ``EDGE_COLUMNS``, None where the candidate has no edge."""
    if loop is None:
        return (None,) * len(EDGE_COLUMNS)
    information = _to_blob(loop.information, "<f8")
    return (*encode_pose(loop.T_match_query), information, loop_id, admitted_by)


def decode_candidate(row: Any) -> Candidate:
    """Return the candidate in a row of ``candidates``."""
    values: dict[str, Any] = {name: row[name] for name in CANDIDATE_COLUMNS}
    values |= {name: math.nan for name, value in values.items() if value is None}
    values["source"] = CandidateSource(values["source"])
    values["kind"] = EdgeKind(values["kind"])
    values["decision"] = Decision(values["decision"])
    return Candidate(**values)


def decode_loop(row: Any) -> Loop:
    """Return the edge in a row of ``loops``, or in a row of ``candidates`` that has one."""
    return Loop(
        query_id=row["query_id"],
        match_id=row["match_id"],
        T_match_query=decode_pose(row),
        information=_from_blob(row["information"], "<f8").reshape(6, 6),
        kind=EdgeKind(row["kind"]),
        source=CandidateSource(row["source"]),
    )


def encode_pose(T: Pose) -> list[float]:
    """Return tx ty tz qx qy qz qw of a pose (4, 4)."""
    return [*T[:3, 3].tolist(), *se3.to_quaternion(T).tolist()]


def decode_pose(row: Any, prefix: str = "") -> Pose:
    """Return the pose (4, 4) in the columns ``<prefix>tx ... <prefix>qw``."""
    values = [row[prefix + name] for name in POSE_COLUMNS]
    return se3.from_quaternion(values[3:], values[:3])


def _scene(row: Any, columns: Sequence[str], classes: tuple[str, ...]) -> Scene | None:
    label, probability, probabilities = (row[name] for name in columns)
    if label is None:
        return None
    return Scene(label, probability, classes, _from_blob(probabilities, "<f8"))


def _to_blob(values: ArrayLike, dtype: str) -> bytes:
    return np.asarray(values).astype(dtype).tobytes()


def _to_npy(array: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def _from_blob(blob: bytes, dtype: str) -> NDArray[Any]:
    return np.frombuffer(blob, dtype)


def _pose_of_3x4(blob: bytes) -> Pose:
    """Return the pose (4, 4) whose first three rows are given."""
    return np.vstack([_from_blob(blob, "<f8").reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
