"""The depth images of some pairs of keyframes, for the report of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_bof.geometry import view_stride
from slam_bof.store import MapStore
from slam_bof.types import Candidate, Decision, EdgeKind
from slam_bof.visualization import PicturedPair

__all__ = ["picture_pairs"]

MAX_PAIRS = 6
"""Largest number of pairs of each decision, evenly chosen."""


def picture_pairs(
    store: MapStore, candidates: Sequence[Candidate], session: int
) -> list[PicturedPair]:
    """Return some accepted and rejected loops of a session with their saved depth images.

    The ids of ``candidates`` count from the session's first keyframe.
    """
    own = (row["id"] for row in store.keyframe_rows() if row["session"] == session)
    first_id = next(own, 0)
    pairs = []
    for decision in (Decision.ACCEPTED, Decision.REJECTED):
        found = [c for c in candidates if (c.kind, c.decision) == (EdgeKind.LOOP, decision)]
        chosen = np.linspace(0, len(found) - 1, min(MAX_PAIRS, len(found))).round()
        for candidate in (found[k] for k in chosen.astype(int).tolist()):
            views = [store.view(first_id + k) for k in (candidate.query_id, candidate.match_id)]
            images = [v.depth_m(view_stride(v.intrinsics)) for v in views if v is not None]
            if len(images) == 2:
                pairs.append(PicturedPair(candidate, np.hstack(images)))
    return pairs
