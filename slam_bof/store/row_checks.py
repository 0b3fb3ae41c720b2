"""Checks of the rows of ``map.db``: whole as written, and with values that a map can have.

A checksum finds damage. It does not say that a file was written by slam_bof: what comes from
elsewhere may have any values under a right checksum, so types, ranges and blobs are checked too.
"""

from __future__ import annotations

import json
import math
import operator
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from functools import cache
from typing import Any

from slam_bof.bof import CONTOUR_BYTES
from slam_bof.core import parse_npy
from slam_bof.geometry import se3
from slam_bof.store.schema import POSE_COLUMNS, SMOOTHED_COLUMNS, TABLES
from slam_bof.store.sqlite import is_intact
from slam_bof.types import CandidateSource, Decision, EdgeKind, Intrinsics

__all__ = ["CHECKSUM_DIFFERS", "POSE_BYTES", "SKIPPED", "STATE", "find_fault"]

CHECKSUM_DIFFERS = "differs from what was written (checksum)"
DIRECTION, POSE, MATRIX = struct.Struct("<3d"), struct.Struct("<12d"), struct.Struct("<36d")
POSE_BYTES, MATRIX_BYTES = POSE.size, MATRIX.size
"""Sizes of a pose (3, 4), and of an information or covariance matrix (6, 6)."""
MAX_SESSIONS = 100_000
"""Largest number of sessions: a map that is restored begins one after another of them."""
MAX_NUMBER = 1e18
"""Largest number in a row; times may be in any unit."""
UNBOUNDED = ("rmse_m", "score", "normaliser", "eta")
"""What may be infinite: a pair without correspondences has no error that is small enough."""
MAX_TEXT = 1_000_000
"""Characters of a text; a configuration has some 10,000."""
MAX_PATH = 4096
"""Characters of the path of a run's sequence."""
SUM_TOLERANCE = 1e-3
"""Largest deviation of a sum of probabilities, or of the square of a quaternion, from 1."""

SKIPPED, STATE = "skipped", "state/"
"""Names of rows of ``odometry``."""

EDGE_COLUMNS = (*POSE_COLUMNS, "information")
ODOM_COLUMNS, MAP_COLUMNS = (
    tuple(f"{prefix}_{name}" for name in POSE_COLUMNS) for prefix in ("odom", "map")
)
FRAME_POSES = ("T_odom_raw", "T_odom_camera", "T_view_camera")
SCENE_COLUMNS = (("scene", "scene_probability", "probabilities"), tuple(SMOOTHED_COLUMNS)[:3])

Row = dict[str, Any]
"""The values of a row by the name of the column."""
TYPES = {"INTEGER": (int,), "REAL": (float, int), "TEXT": (str,), "BLOB": (bytes,)}


class _Fault(ValueError):
    """What is wrong with a row."""


def find_fault(table: str, row: Any) -> str:
    """Return what is wrong with a row of a table, all of whose columns it has; "" if nothing."""
    values = tuple(row)
    if not is_intact(values):
        return CHECKSUM_DIFFERS
    try:
        _check(table, values)
    except _Fault as fault:
        return str(fault)
    return ""


def _check(table: str, values: tuple[Any, ...]) -> None:
    """Raise ``_Fault`` for the first implausible value of an intact row."""
    wrong, numbers, texts = _inspect_types(table, tuple(map(type, values)))
    _expect(not wrong, wrong)
    row = dict(zip(_names(table), values, strict=True))
    found = [row[name] for name in numbers]
    if max(found) >= MAX_NUMBER or min(found) <= -MAX_NUMBER:  # SQLite reads NaN as null
        for name in numbers:
            _expect(abs(row[name]) < MAX_NUMBER or name in UNBOUNDED, name)
    for name in texts:
        _expect(len(row[name]) < MAX_TEXT and _is_unicode(row[name]), name)
    CHECKS[table](row)


@cache
def _inspect_types(
    table: str, types: tuple[type, ...]
) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Return the first column whose value has a wrong type, and which are numbers and texts.

    Rows of a table have few combinations of types, so that the answers are cached.
    """
    wrong = ""
    for (name, declared, is_required), found in zip(_columns(table), types, strict=True):
        if found not in TYPES[declared] and (is_required or found is not type(None)):
            wrong = wrong or name
    kinds = list(zip(_names(table), types, strict=True))
    numbers = tuple(name for name, kind in kinds if kind in (int, float))
    return wrong, numbers, tuple(name for name, kind in kinds if kind is str)


@cache
def _names(table: str) -> tuple[str, ...]:
    return tuple(name for name, *_ in _columns(table))


@cache
def _columns(table: str) -> list[tuple[str, str, bool]]:
    """Return name, type, and whether a value is required, of the columns of a table."""
    with closing(sqlite3.connect(":memory:")) as db:
        db.executescript(TABLES)
        rows = db.execute(f"PRAGMA table_info({table})").fetchall()
    return [(name, kind, bool(required or is_key)) for _, name, kind, required, _, is_key in rows]


def _check_keyframe(row: Row) -> None:
    _expect(min(row["id"], row["session"], row["frame_index"], row["segment"]) >= 0, "id")
    _expect(row["session"] < MAX_SESSIONS, "session")
    _check_pose([row[name] for name in ODOM_COLUMNS], "odom_")
    T_map_camera = [row[name] for name in MAP_COLUMNS]
    if _is_given(T_map_camera, MAP_COLUMNS[0]):
        _check_pose(T_map_camera, "map_")
    for columns in SCENE_COLUMNS:
        scene = [row[name] for name in columns]
        if _is_given(scene, columns[0]):
            _, probability, blob = scene
            _check_probability(probability, columns[1])
            probabilities = _unpack(blob, "d", columns[2])
            is_one = abs(sum(probabilities) - 1.0) < SUM_TOLERANCE  # also: none is NaN
            _expect(is_one and min(probabilities) >= 0.0, columns[2])
    words, weights = _unpack(row["words"], "i", "words"), _unpack(row["weights"], "f", "weights")
    _expect(len(words) == len(weights), "words")
    if words:
        _expect(words[0] >= 0 and all(map(operator.lt, words, words[1:])), "words")
        _expect(min(weights) >= 0.0 and sum(weights) < math.inf, "weights")  # also: none is NaN


def _check_view(row: Row) -> None:
    _expect(row["keyframe_id"] >= 0, "keyframe_id")
    _expect(1 <= row["per_m"] <= 65535, "per_m")


def _check_constellation(row: Row) -> None:
    _expect(row["keyframe_id"] >= 0, "keyframe_id")
    _expect(len(row["gravity"]) == DIRECTION.size, "gravity")
    square = sum(value * value for value in DIRECTION.unpack(row["gravity"]))
    _expect(abs(square - 1.0) < SUM_TOLERANCE, "gravity")
    _expect(len(row["contours"]) % CONTOUR_BYTES == 0, "contours")
    _expect(row["weight"] >= 0.0, "weight")


def _check_frame(row: Row) -> None:
    _expect(min(row["session"], row["frame_index"], row["segment"] + 1) >= 0, "segment")
    for name in FRAME_POSES:
        blob = row[name]
        if blob is None:
            continue
        pose, more = blob[:POSE_BYTES], blob[POSE_BYTES:]
        _expect(len(pose) == POSE_BYTES and _is_rigid(*POSE.unpack(pose)), name)
        if more:
            _expect(name == "T_odom_camera", name)
            _check_matrix(more, name)


def _check_candidate(row: Row) -> None:
    _expect(min(row["query_id"], row["match_id"], row["n_consistent"]) >= 0, "query_id")
    _expect(row["source"] in SOURCES, "source")
    _expect(row["kind"] in KINDS, "kind")
    _expect(row["decision"] in DECISIONS, "decision")
    edge = [row[name] for name in EDGE_COLUMNS]
    if _is_given(edge, EDGE_COLUMNS[0]):
        _check_pose(edge[:-1], "")
        _check_matrix(edge[-1], "information")
    else:
        _expect(row["loop_id"] is None, "loop_id")
    _expect((row["loop_id"] is None) == (row["admitted_by"] is None), "admitted_by")


def _check_culled(row: Row) -> None:
    _expect(0 <= row["anchor_id"] < row["keyframe_id"] < row["culled_by"], "anchor_id")


def _check_odometry(row: Row) -> None:
    name = row["name"]
    _expect(name == SKIPPED or name.startswith(STATE), "name")
    _expect(0 <= row["session"] < MAX_SESSIONS and row["frame_index"] >= 0, "frame_index")
    try:
        array = parse_npy(row["value"])
    except ValueError:
        raise _Fault("has no plausible value") from None
    _expect(array.dtype.kind in "biuf", "value")
    if name == SKIPPED:
        _expect(array.dtype == "int64" and array.ndim == 1, "value")


def _check_region(row: Row) -> None:
    _check_probability(row["probability"], "probability")
    _expect(min(row["id"], row["n_keyframes"]) >= 0, "n_keyframes")


def _check_session(row: Row) -> None:
    _expect(0 <= row["id"] < MAX_SESSIONS and row["seed"] >= 0, "id")
    _expect(row["max_frames"] is None or row["max_frames"] > 0, "max_frames")
    if row["state"] is not None:
        _expect(isinstance(_json(row["state"], "state"), dict), "state")


def _check_parameter(row: Row) -> None:
    key, value = row["key"], row["value"]
    if key == "camera":
        camera = _json(value, key)
        try:
            Intrinsics(**camera)
        except (TypeError, ValueError) as error:
            raise _Fault(f"{error}; found {value[:120]}, expected a camera") from error
    elif key == "classes":
        classes = _json(value, key)
        _expect(isinstance(classes, list) and all(isinstance(c, str) for c in classes), key)
        _expect(len(set(classes)) == len(classes), key)
    elif key == "units_per_m":
        units = _json(value, key)
        is_number = isinstance(units, float | int) and not isinstance(units, bool)
        _expect(units is None or (is_number and 1.0 <= units < math.inf), key)
    elif key == "source" and value:
        source = _json(value, key)
        _expect(isinstance(source, dict), key)
        path, frames = source.get("path"), source.get("frames")
        _expect(isinstance(path, str) and "\0" not in path and len(path) <= MAX_PATH, key)
        _expect(frames is None or isinstance(frames, str), key)


CHECKS: dict[str, Callable[[Row], None]] = {
    "sessions": _check_session,
    "keyframes": _check_keyframe,
    "views": _check_view,
    "constellations": _check_constellation,
    "frames": _check_frame,
    "candidates": _check_candidate,
    "culled": _check_culled,
    "odometry": _check_odometry,
    "regions": _check_region,
    "parameters": _check_parameter,
}
SOURCES, KINDS, DECISIONS = (frozenset(map(str, e)) for e in (CandidateSource, EdgeKind, Decision))


def _expect(condition: bool, name: str) -> None:
    if not condition:
        raise _Fault(f"has no plausible {name}")


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:  # bytes that were no UTF-8
        return False
    return True


def _is_given(values: list[Any], name: str) -> bool:
    """Return whether columns have values, all of them or none."""
    n_missing = values.count(None)
    _expect(n_missing in (0, len(values)), name)
    return n_missing == 0


def _check_pose(pose: list[float], prefix: str) -> None:
    tx, ty, tz, qx, qy, qz, qw = pose
    _expect(max(abs(tx), abs(ty), abs(tz)) < se3.MAX_POSITION_M, f"{prefix}tx")
    square = qx * qx + qy * qy + qz * qz + qw * qw
    _expect(abs(square - 1.0) < SUM_TOLERANCE, f"{prefix}qx")


def _is_rigid(  # in plain Python: NumPy takes ten times as long for nine numbers
    a: float, b: float, c: float, x: float,
    d: float, e: float, f: float, y: float,
    g: float, h: float, i: float, z: float,
) -> bool:  # fmt: skip
    """Return whether the rows of a pose (3, 4) are a rotation and a position; NaN is neither."""
    lengths = abs(a * a + b * b + c * c - 1) + abs(d * d + e * e + f * f - 1)
    lengths += abs(g * g + h * h + i * i - 1)
    products = abs(a * d + b * e + c * f) + abs(a * g + b * h + c * i) + abs(d * g + e * h + f * i)
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return (
        lengths + products < 6 * se3.TOLERANCE
        and determinant > 0.0
        and abs(x) + abs(y) + abs(z) < se3.MAX_POSITION_M
    )


def _check_probability(probability: float, name: str) -> None:
    _expect(0.0 <= probability <= 1.0 + SUM_TOLERANCE, name)


def _check_matrix(blob: bytes, name: str) -> None:
    """Check an information or covariance matrix (6, 6): finite, no negative variance."""
    _expect(len(blob) == MATRIX_BYTES, name)
    matrix = MATRIX.unpack(blob)
    _expect(-MAX_NUMBER < sum(matrix) < MAX_NUMBER and min(matrix[::7]) >= 0.0, name)


def _unpack(blob: bytes, kind: str, name: str) -> tuple[Any, ...]:
    """Return the few numbers in a blob; an array of them would take longer."""
    n, rest = divmod(len(blob), struct.calcsize(kind))
    _expect(not rest, name)
    return struct.unpack(f"<{n}{kind}", blob)


def _json(text: str, name: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _Fault(f"has no plausible {name}") from error
