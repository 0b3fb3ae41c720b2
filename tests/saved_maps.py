"""Keyframes, loops and candidates of random content, and maps of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_bof.bof import CONTOUR_BYTES
from slam_bof.geometry import se3
from slam_bof.store import MapStore, Session
from slam_bof.types import (
    Bag,
    Candidate,
    CandidateSource,
    Decision,
    FramePose,
    Intrinsics,
    Keyframe,
    KeyframeRecord,
    Loop,
    OdometryState,
    SavedConstellation,
    Scene,
    SubsampledDepth,
)

CLASSES = ("kitchen", "office")
CAMERA = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)
STATE = {"tracker": {}, "detector": {}, "is_around": None}


def make_keyframe(id_: int, *, scene: bool = True, session: int = 0) -> Keyframe:
    rng = np.random.default_rng(id_)
    words = np.sort(rng.choice(1024, 200, replace=False)).astype(np.int32)
    weights = rng.random(200).astype(np.float32)
    p = float(rng.uniform(0.5, 1.0))
    label = Scene(CLASSES[id_ % 2], p, CLASSES, np.roll([p, 1 - p], id_ % 2))
    return Keyframe(
        id_,
        4 * id_,
        4 * id_ / 30.0,
        se3.exp(rng.normal(size=6)),
        Bag(words, weights / weights.sum()),
        label if scene else None,
        id_ // 3,
        session=session,
    )


def make_loop(query_id: int, match_id: int, kind: str = "loop", source: str = "bag") -> Loop:
    rng = np.random.default_rng(query_id)
    A = rng.normal(size=(6, 6))
    return Loop(query_id, match_id, se3.exp(rng.normal(size=6)), A @ A.T, kind, source)


def make_candidate(query_id: int, match_id: int, **fields: object) -> Candidate:
    figures = {"score": 0.25, "normaliser": 0.5, "eta": 0.5, "overlap": 0.7, "rmse_m": 0.012}
    known = {"n_consistent": 2, "decision": Decision.ACCEPTED, "reason": "overlap 0.70", **figures}
    return Candidate(query_id, match_id, CandidateSource.BAG, **(known | fields))


def make_subsampled(id_: int = 0) -> SubsampledDepth:
    depth = np.random.default_rng(id_).integers(500, 4000, (48, 64)).astype(np.uint16)
    return SubsampledDepth(depth, 1000, CAMERA)


def make_constellation(id_: int = 0) -> SavedConstellation:
    rng = np.random.default_rng(id_)
    gravity = rng.normal(size=3)
    contours = rng.bytes(CONTOUR_BYTES * (3 + id_ % 4))
    return SavedConstellation(gravity / np.linalg.norm(gravity), "0a1b", contours, 2.5 + id_)


def make_odometry(frame_index: int) -> OdometryState:
    rng = np.random.default_rng(frame_index)
    points = rng.normal(size=(5 + frame_index, 3))
    return OdometryState(frame_index, np.array([1, 3]), {"points": points, "n": np.array(7)})


def make_record(
    keyframe: Keyframe,
    candidates: Sequence[Candidate] = (),
    admitted: Sequence[Loop] = (),
    *,
    n_frames: int = 4,
) -> KeyframeRecord:
    """What a keyframe came to after ``n_frames`` since the one before; all own loops are taken.

    A loop that is no candidate becomes one.
    """
    own = tuple(loop for loop in admitted if loop.query_id == keyframe.id)
    named = {(c.match_id, c.source) for c in candidates}
    unnamed = [
        Candidate(
            loop.query_id, loop.match_id, loop.source, kind=loop.kind, decision=Decision.ACCEPTED
        )
        for loop in own
        if (loop.match_id, loop.source) not in named
    ]
    n = min(n_frames, keyframe.frame_index + 1)
    T = keyframe.T_odom_camera
    frames = [
        FramePose(keyframe.stamp_s - (n - 1 - k) / 30.0, T, T, keyframe.segment) for k in range(n)
    ]
    return KeyframeRecord(
        keyframe,
        make_subsampled(keyframe.id),
        tuple(frames),
        (*candidates, *unnamed),
        own,
        tuple(admitted),
        STATE,
        constellation=make_constellation(keyframe.id),
    )


def save(
    store: MapStore,
    keyframe: Keyframe,
    candidates: Sequence[Candidate] = (),
    admitted: Sequence[Loop] = (),
    **more: int,
) -> None:
    """Write a keyframe, and the session that it is of if that is new."""
    if keyframe.session == len(store.sessions()):
        store.begin_session(Session(keyframe.session, "7scenes", "room/seq-01", "", 0, "1.0"))
    store.write(make_record(keyframe, candidates, admitted, **more))


def save_six(store: MapStore, candidates: Sequence[Candidate], loops: Sequence[Loop]) -> None:
    """Save six keyframes, the last of which has candidates and loops."""
    for id_ in range(5):
        save(store, make_keyframe(id_))
    save(store, make_keyframe(5), candidates, loops)
