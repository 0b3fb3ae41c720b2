"""Checks of the rows of ``map.db``: whole as written, and with values that a map can have.

A checksum finds damage. It does not say that a file was written by slam_bof: what comes from
elsewhere may have any values under a right checksum, so types, ranges and blobs are checked too.
"""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache
from typing import Any, cast

import numpy as np

from slam_bof.geometry import se3
from slam_bof.store.schema import POSE_COLUMNS, SMOOTHED_COLUMNS, TABLES
from slam_bof.store.sqlite import is_intact
from slam_bof.types import Array, CandidateSource, Decision, EdgeKind, Intrinsics

__all__ = ["CHECKSUM_DIFFERS", "POSE_BYTES", "find_fault"]

CHECKSUM_DIFFERS = "differs from what was written (checksum)"
POSE = struct.Struct("<12d")
POSE_BYTES, MATRIX_BYTES = POSE.size, 36 * 8
"""Sizes of a pose (3, 4), and of an information or covariance matrix (6, 6)."""
MAX_SESSIONS = 100_000
MAX_NUMBER = 1e18
"""Largest number in a row; times may be in any unit."""
UNBOUNDED = ("rmse_m", "score", "normaliser", "eta")
"""What may be infinite: a pair without correspondences has no error that is small enough."""
MAX_TEXT = 1_000_000
"""Characters of a text; a configuration has some 10,000."""
SUM_TOLERANCE = 1e-3
"""Largest deviation of a sum of probabilities, or of the square of a quaternion, from 1."""

EDGE_COLUMNS = (*POSE_COLUMNS, "information")
MAP_COLUMNS = tuple(f"map_{name}" for name in POSE_COLUMNS)
SCENE_COLUMNS = (("scene", "scene_probability", "probabilities"), tuple(SMOOTHED_COLUMNS)[:3])

Row = Any
TYPES = {"INTEGER": (int,), "REAL": (float, int), "TEXT": (str,), "BLOB": (bytes,)}


class _Fault(ValueError):
    """What is wrong with a row."""


def find_fault(table: str, row: Row) -> str:
    """Return what is wrong with a row of a table, all of whose columns it has; "" if nothing."""
    if not is_intact(row):
        return CHECKSUM_DIFFERS
    try:
        _check(table, row)
    except _Fault as fault:
        return str(fault)
    return ""


def _check(table: str, row: Row) -> None:
    """Raise ``_Fault`` for the first implausible value of an intact row."""
    values = tuple(row)
    wrong, numbers, texts = _inspect_types(table, tuple(map(type, values)))
    _expect(not wrong, wrong)
    for k in numbers:
        if not -MAX_NUMBER < values[k] < MAX_NUMBER:
            _expect(row.keys()[k] in UNBOUNDED and not math.isnan(values[k]), row.keys()[k])
    for k in texts:
        if not (len(values[k]) < MAX_TEXT and _is_unicode(values[k])):
            _expect(False, row.keys()[k])
    CHECKS[table](row)


@cache
def _inspect_types(
    table: str, types: tuple[type, ...]
) -> tuple[str, tuple[int, ...], tuple[int, ...]]:
    """Return the first column whose value has a wrong type, and which are numbers and texts.

    Rows of a table have few combinations of types, so that the answers are cached.
    """
    wrong = ""
    for (name, declared, is_required), found in zip(_columns(table), types, strict=True):
        if found not in TYPES[declared] and (is_required or found is not type(None)):
            wrong = wrong or name
    numbers = tuple(k for k, kind in enumerate(types) if kind in (int, float))
    return wrong, numbers, tuple(k for k, kind in enumerate(types) if kind is str)


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
    _check_pose(row, "odom_")
    if _is_given(row, MAP_COLUMNS):
        _check_pose(row, "map_")
    for columns in SCENE_COLUMNS:
        if _is_given(row, columns):
            _check_probability(row, columns[1])
            probabilities = _numbers(row, columns[2], "<f8")
            total = float(probabilities.sum())
            _expect(probabilities.size > 0 and probabilities.min() >= 0.0, columns[2])
            _expect(abs(total - 1.0) < SUM_TOLERANCE, columns[2])
    words, weights = _numbers(row, "words", "<i4"), _numbers(row, "weights", "<f4")
    _expect(words.shape == weights.shape, "words")
    if words.size:
        _expect(words[0] >= 0 and (np.diff(words) > 0).all(), "words")
        _expect(weights.min() >= 0.0, "weights")


def _check_view(row: Row) -> None:
    _expect(row["keyframe_id"] >= 0, "keyframe_id")
    _expect(1 <= row["per_m"] <= 65535, "per_m")


def _check_frame(row: Row) -> None:
    _expect(min(row["session"], row["frame_index"]) >= 0 and row["segment"] >= -1, "segment")
    for name in ("T_odom_raw", "T_odom_camera", "T_view_camera"):
        if row[name] is None:
            continue
        pose, more = row[name][:POSE_BYTES], row[name][POSE_BYTES:]
        _expect(len(pose) == POSE_BYTES and _is_rigid(*POSE.unpack(pose)), name)
        if more:
            _expect(name == "T_odom_camera", name)
            _check_matrix(more, name)


def _check_candidate(row: Row) -> None:
    _expect(min(row["query_id"], row["match_id"], row["n_consistent"]) >= 0, "query_id")
    for name, known in (("source", SOURCES), ("kind", KINDS), ("decision", DECISIONS)):
        _expect(row[name] in known, name)
    if _is_given(row, EDGE_COLUMNS):
        _check_pose(row, "")
        _check_matrix(row["information"], "information")
    else:
        _expect(row["loop_id"] is None, "loop_id")
    _expect((row["loop_id"] is None) == (row["admitted_by"] is None), "admitted_by")


def _check_culled(row: Row) -> None:
    _expect(0 <= row["anchor_id"] < row["keyframe_id"] < row["culled_by"], "anchor_id")


def _check_region(row: Row) -> None:
    _check_probability(row, "probability")
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
        except (TypeError, ValueError, OverflowError) as error:
            raise _Fault(f"{error}; found {value[:120]}, expected a camera") from error
    elif key == "classes":
        classes = _json(value, key)
        _expect(isinstance(classes, list) and all(isinstance(c, str) for c in classes), key)
        _expect(len(set(classes)) == len(classes), key)
    elif key == "units_per_m":
        units = _json(value, key)
        is_number = isinstance(units, float | int) and not isinstance(units, bool)
        _expect(units is None or (is_number and 1.0 <= units < math.inf), key)


CHECKS: dict[str, Callable[[Row], None]] = {
    "sessions": _check_session,
    "keyframes": _check_keyframe,
    "views": _check_view,
    "frames": _check_frame,
    "candidates": _check_candidate,
    "culled": _check_culled,
    "regions": _check_region,
    "parameters": _check_parameter,
}
SOURCES, KINDS, DECISIONS = (frozenset(map(str, e)) for e in (CandidateSource, EdgeKind, Decision))


def _expect(condition: bool | np.bool_, name: str) -> None:
    if not condition:
        raise _Fault(f"has no plausible {name}")


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:  # bytes that were no UTF-8
        return False
    return True


def _is_given(row: Row, names: Sequence[str]) -> bool:
    """Return whether columns have values, all of them or none."""
    missing = [row[name] is None for name in names]
    _expect(len(set(missing)) == 1, names[0])
    return not missing[0]


def _check_pose(row: Row, prefix: str) -> None:
    tx, ty, tz, qx, qy, qz, qw = (row[prefix + name] for name in POSE_COLUMNS)
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


def _check_probability(row: Row, name: str) -> None:
    _expect(0.0 <= row[name] <= 1.0 + SUM_TOLERANCE, name)


def _check_matrix(blob: bytes, name: str) -> None:
    """Check an information or covariance matrix (6, 6): finite, no negative variance."""
    _expect(len(blob) == MATRIX_BYTES, name)
    matrix = np.frombuffer(blob, "<f8")
    _expect(-MAX_NUMBER < matrix.sum() < MAX_NUMBER, name)
    _expect(matrix[::7].min() >= 0.0, name)


def _numbers(row: Row, name: str, dtype: str) -> Array:
    """Return the finite numbers of a blob."""
    blob = row[name]
    _expect(len(blob) % np.dtype(dtype).itemsize == 0, name)
    numbers = np.frombuffer(blob, dtype)
    _expect(np.isfinite(numbers).all(), name)
    return cast(Array, numbers)


def _json(text: str, name: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _Fault(f"has no plausible {name}") from error
