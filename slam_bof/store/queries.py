"""Queries of a saved map, answered with plain values that can be printed or written as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from slam_bof.errors import MapError
from slam_bof.scenes import UNKNOWN_LABEL, MapRoom
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import decode_scene
from slam_bof.store.schema import POSE_COLUMNS

__all__ = [
    "KeyframeInfo",
    "LoopInfo",
    "query_keyframes",
    "query_loops",
    "query_rooms",
]

Labels = Literal["smoothed", "raw"]
Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class KeyframeInfo:
    """A keyframe of a map.

    ``translation_m`` and ``quaternion_xyzw`` are the camera's pose in ``frame``: "map", or "odom"
    while the keyframe has no optimised pose. ``scene`` is the label of the keyframe's image alone,
    with the ``probabilities`` of all labels, most likely first. ``smoothed`` is the label that
    also uses the keyframes before and after, "unknown" where none is likely enough. ``region`` is
    the id of the room the keyframe is in. ``apart_s`` and ``distance_m`` are the time difference
    and distance to the time and position that were asked for.
    """

    id: int
    frame_index: int
    stamp_s: float
    scene: str | None
    scene_probability: float | None
    smoothed: str | None
    smoothed_probability: float | None
    region: int | None
    frame: str
    translation_m: Position
    quaternion_xyzw: Quaternion
    n_loops: int
    probabilities: dict[str, float]
    apart_s: float | None = None
    distance_m: float | None = None


@dataclass(frozen=True, slots=True)
class LoopInfo:
    """An accepted loop; ``translation_m`` and ``quaternion_xyzw`` are T_match_query."""

    query_id: int
    match_id: int
    query_stamp_s: float
    match_stamp_s: float
    source: str
    translation_m: Position
    quaternion_xyzw: Quaternion


def query_keyframes(
    store: MapStore,
    *,
    keyframe_id: int | None = None,
    time_s: float | None = None,
    near_m: Sequence[float] | None = None,
    scene: str | None = None,
    min_probability: float = 0.0,
    labels: Labels = "smoothed",
    limit: int | None = None,
) -> list[KeyframeInfo]:
    """Return the keyframes that meet all conditions given.

    Parameters
    ----------
    store
        The map.
    keyframe_id
        Return only this keyframe.
    time_s
        Order by the time difference to this time.
    near_m
        Order by the distance to this position (x, y, z) in the map frame.
    scene, min_probability
        Return only keyframes with this label, and with a label of at least this probability.
    labels
        Which label is meant: ``smoothed`` (where there is none, the raw one) or ``raw``.
    limit
        Return at most this many.

    Raises
    ------
    MapError
        If the map has no such keyframe or no such scene label.
    """
    _check_scene(store, scene)
    label, probability = "scene", "scene_probability"
    if labels == "smoothed":
        label = "coalesce(smoothed, scene)"
        probability = "coalesce(smoothed_probability, scene_probability)"
    rows = store.select(
        "SELECT *, (SELECT count(*) FROM loops WHERE query_id = k.id AND kind = 'loop') AS n_loops"
        " FROM keyframes AS k WHERE (?1 IS NULL OR id = ?1)"
        f" AND (?2 IS NULL OR {label} = ?2) AND (?3 <= 0 OR {probability} >= ?3) ORDER BY id",
        keyframe_id,
        scene,
        min_probability,
    )
    if keyframe_id is not None and scene is None and min_probability <= 0 and not rows:
        ((n,),) = store.select("SELECT count(*) FROM keyframes")
        raise MapError(
            f"{store.path}: found no keyframe {keyframe_id}, expected 0 to {n - 1}"
            if n
            else f"{store.path}: found no keyframes, expected keyframe {keyframe_id}"
        )
    records = [_keyframe_info(store, row, time_s, near_m) for row in rows]
    if time_s is not None:
        records.sort(key=lambda record: record.apart_s or 0.0)
    if near_m is not None:
        records.sort(key=lambda record: record.distance_m or 0.0)
    return records[:limit]


def query_rooms(
    store: MapStore, *, scene: str | None = None, min_probability: float = 0.0
) -> list[MapRoom]:
    """Return the rooms of a map; of one scene label, the most probable first.

    Raises
    ------
    MapError
        If the map has no such scene label.
    """
    _check_scene(store, scene)
    found = [
        region
        for region in store.regions()
        if scene in (None, region.label) and region.probability >= min_probability
    ]
    return sorted(found, key=lambda region: -region.probability) if scene else found


def query_loops(store: MapStore, *, keyframe_id: int | None = None) -> list[LoopInfo]:
    """Return the accepted loops, all or those of one keyframe, without covisibility edges."""
    rows = store.select(
        "SELECT loops.*, q.stamp_s AS query_stamp_s, m.stamp_s AS match_stamp_s FROM loops"
        " JOIN keyframes AS q ON q.id = query_id JOIN keyframes AS m ON m.id = match_id"
        " WHERE kind = 'loop' AND (?1 IS NULL OR ?1 IN (query_id, match_id)) ORDER BY loops.id",
        keyframe_id,
    )
    names = ("query_id", "match_id", "query_stamp_s", "match_stamp_s", "source")
    records: list[LoopInfo] = []
    for row in rows:
        values: dict[str, Any] = {name: row[name] for name in names}
        translation_m, quaternion_xyzw = _pose(row, "")
        records.append(
            LoopInfo(translation_m=translation_m, quaternion_xyzw=quaternion_xyzw, **values)
        )
    return records


def _check_scene(store: MapStore, scene: str | None) -> None:
    classes = store.classes()
    if scene is None or scene in classes or (scene == UNKNOWN_LABEL and classes):
        return
    known = ", ".join((*classes, UNKNOWN_LABEL)) if classes else "none, it has no labels"
    raise MapError(f"{store.path}: found no scene {scene!r}, expected one of: {known}")


def _keyframe_info(
    store: MapStore, row: Any, time_s: float | None, near_m: Sequence[float] | None
) -> KeyframeInfo:
    frame = "odom" if row["map_tx"] is None else "map"
    translation_m, quaternion_xyzw = _pose(row, f"{frame}_")
    probabilities: dict[str, float] = {}
    if (label := decode_scene(row, store.classes())) is not None:
        pairs = zip(label.classes, label.probabilities.tolist(), strict=True)
        probabilities = dict(sorted(pairs, key=lambda pair: -pair[1]))
    return KeyframeInfo(
        id=row["id"],
        frame_index=row["frame_index"],
        stamp_s=row["stamp_s"],
        scene=row["scene"],
        scene_probability=row["scene_probability"],
        smoothed=row["smoothed"],
        smoothed_probability=row["smoothed_probability"],
        region=row["region"],
        frame=frame,
        translation_m=translation_m,
        quaternion_xyzw=quaternion_xyzw,
        n_loops=row["n_loops"],
        probabilities=probabilities,
        apart_s=None if time_s is None else abs(row["stamp_s"] - time_s),
        distance_m=(
            None if near_m is None else float(np.linalg.norm(np.subtract(translation_m, near_m)))
        ),
    )


def _pose(row: Any, prefix: str) -> tuple[Position, Quaternion]:
    tx, ty, tz, qx, qy, qz, qw = (row[prefix + name] for name in POSE_COLUMNS)
    return (tx, ty, tz), (qx, qy, qz, qw)
