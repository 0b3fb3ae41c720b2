"""Queries of a saved map, answered with plain values that can be printed or written as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from slam_bof.errors import MapError
from slam_bof.scenes import UNKNOWN_LABEL, MapRoom
from slam_bof.store.map_components import choose_component, join_rows
from slam_bof.store.map_store import MapStore
from slam_bof.store.schema import POSE_COLUMNS
from slam_bof.types import EdgeKind, Scene

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

    ``frame_index`` counts in the whole sequence, also where the run took a slice of it.
    ``translation_m`` and ``quaternion_xyzw`` are the camera's pose in ``frame``: "map", or "odom"
    while the keyframe has no optimised pose. ``scene`` is the label of the keyframe's image alone,
    with the ``probabilities`` of all labels, most likely first. ``smoothed`` is the label that
    also uses the keyframes before and after, "unknown" where none is likely enough. ``region`` is
    the id of the room the keyframe is in. Poses of keyframes of another ``component`` of the pose
    graph are not comparable. ``apart_s`` and ``distance_m`` are the time difference
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
    component: int
    apart_s: float | None = None
    distance_m: float | None = None


@dataclass(frozen=True, slots=True)
class LoopInfo:
    """A pair of keyframes that was considered as a loop, the decision, and the reason for it.

    ``translation_m`` and ``quaternion_xyzw`` are T_match_query. What was not measured is None. The
    decision is "accepted", "rejected" or "held". ``component`` is that of the query.
    """

    query_id: int
    match_id: int
    query_stamp_s: float
    match_stamp_s: float
    source: str
    decision: str
    reason: str
    score: float | None
    overlap: float | None
    rmse_m: float | None
    translation_m: Position | None
    quaternion_xyzw: Quaternion | None
    component: int


def query_keyframes(
    store: MapStore,
    *,
    keyframe_id: int | None = None,
    time_s: float | None = None,
    near_m: Sequence[float] | None = None,
    scene: str | None = None,
    min_probability: float = 0.0,
    labels: Labels = "smoothed",
    component: int | None = None,
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
        Order by the distance to this position (x, y, z) in the map frame, and return only
        keyframes of one component, by default of the largest.
    scene, min_probability
        Return only keyframes with this label, and with a label of at least this probability.
    labels
        Which label is meant: ``smoothed`` (where there is none, the raw one) or ``raw``.
    component
        Return only keyframes of this component of the pose graph.
    limit
        Return at most this many.

    Raises
    ------
    MapError
        If the map has no such keyframe, scene label or component.
    """
    with store.snapshot():
        _check_scene(store, scene)
        rows = store.keyframe_rows()
        components = join_rows(store, rows)
        loops = store.loop_rows(covisibility=False)
        n_loops = Counter(row["query_id"] for row in loops if row["kind"] == EdgeKind.LOOP)
        if keyframe_id is not None and not 0 <= keyframe_id < len(rows):
            raise MapError(
                f"{store.path}: found no keyframe {keyframe_id}, expected 0 to {len(rows) - 1}"
                if rows
                else f"{store.path}: found no keyframes, expected keyframe {keyframe_id}"
            )
        inside = np.ones(len(rows), bool)
        if component is not None or near_m is not None:
            inside = choose_component(store, component)
        first_frames = {session.id: session.first_frame for session in store.sessions()}
        names = rows[0].keys() if rows else []  # looking them up in each row takes long
        records = [
            _keyframe_info(
                store.scene(row),
                row,
                first_frame=first_frames[row["session"]],
                n_loops=n_loops[row["id"]],
                component=int(components[row["id"]]),
                time_s=time_s,
                near_m=near_m,
            )
            for row in (dict(zip(names, values, strict=True)) for values in rows)
            if inside[row["id"]]
            and keyframe_id in (None, row["id"])
            and _has_label(row, scene, min_probability, labels)
        ]
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
    with store.snapshot():
        _check_scene(store, scene)
        rooms = store.rooms()
    found = [
        room
        for room in rooms
        if scene in (None, room.label) and room.probability >= min_probability
    ]
    return sorted(found, key=lambda room: -room.probability) if scene else found


def query_loops(
    store: MapStore, *, keyframe_id: int | None = None, considered: bool = False
) -> list[LoopInfo]:
    """Return the loops, all or those of one keyframe, without covisibility edges.

    They are those of the pose graph, or all pairs that were ``considered``, whatever the decision.
    """
    tail = "WHERE kind = 'loop' AND (? IS NULL OR ? IN (query_id, match_id))"
    tail += " AND (? OR (decision = 'accepted' AND loop_id IS NOT NULL))"
    tail += " ORDER BY loop_id IS NULL, loop_id, id"
    with store.snapshot():
        rows = store.candidate_rows(tail, keyframe_id, keyframe_id, considered)
        keyframes = store.keyframe_rows()
        components = join_rows(store, keyframes)
    stamps_s = [row["stamp_s"] for row in keyframes]
    names = ("query_id", "match_id", "source", "decision", "reason", "score", "overlap", "rmse_m")
    records: list[LoopInfo] = []
    for row in rows:
        values: dict[str, Any] = {name: row[name] for name in names}
        translation_m, quaternion_xyzw = _pose(row, "") if row["tx"] is not None else (None, None)
        records.append(
            LoopInfo(
                query_stamp_s=stamps_s[row["query_id"]],
                match_stamp_s=stamps_s[row["match_id"]],
                translation_m=translation_m,
                quaternion_xyzw=quaternion_xyzw,
                component=int(components[row["query_id"]]),
                **values,
            )
        )
    return records


def _check_scene(store: MapStore, scene: str | None) -> None:
    classes = store.classes()
    if scene is None or scene in classes or (scene == UNKNOWN_LABEL and classes):
        return
    known = ", ".join((*classes, UNKNOWN_LABEL)) if classes else "none, it has no labels"
    raise MapError(f"{store.path}: found no scene {scene!r}, expected one of: {known}")


def _has_label(row: Any, scene: str | None, min_probability: float, labels: Labels) -> bool:
    """Return whether a keyframe has a label, by default any, that is probable enough."""
    label, probability = row["scene"], row["scene_probability"]
    if labels == "smoothed" and row["smoothed"] is not None:
        label, probability = row["smoothed"], row["smoothed_probability"]
    return scene in (None, label) and (
        min_probability <= 0 or (probability is not None and probability >= min_probability)
    )


def _keyframe_info(
    scene: Scene | None,
    row: Any,
    *,
    first_frame: int,
    n_loops: int,
    component: int,
    time_s: float | None,
    near_m: Sequence[float] | None,
) -> KeyframeInfo:
    frame = "odom" if row["map_tx"] is None else "map"
    translation_m, quaternion_xyzw = _pose(row, f"{frame}_")
    probabilities: dict[str, float] = {}
    if scene is not None:
        pairs = zip(scene.classes, scene.probabilities.tolist(), strict=True)
        probabilities = dict(sorted(pairs, key=lambda pair: -pair[1]))
    return KeyframeInfo(
        id=row["id"],
        frame_index=first_frame + row["frame_index"],
        stamp_s=row["stamp_s"],
        scene=row["scene"],
        scene_probability=row["scene_probability"],
        smoothed=row["smoothed"],
        smoothed_probability=row["smoothed_probability"],
        region=row["region"],
        frame=frame,
        translation_m=translation_m,
        quaternion_xyzw=quaternion_xyzw,
        n_loops=n_loops,
        probabilities=probabilities,
        component=component,
        apart_s=None if time_s is None else abs(row["stamp_s"] - time_s),
        distance_m=(
            None if near_m is None else float(np.linalg.norm(np.subtract(translation_m, near_m)))
        ),
    )


def _pose(row: Any, prefix: str) -> tuple[Position, Quaternion]:
    tx, ty, tz, qx, qy, qz, qw = [row[prefix + name] for name in POSE_COLUMNS]
    return (tx, ty, tz), (qx, qy, qz, qw)
