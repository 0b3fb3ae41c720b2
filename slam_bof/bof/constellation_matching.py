"""The motion between two views by their constellations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation import Constellation
from slam_bof.bof.constellation_consensus import Motions, find_motions
from slam_bof.bof.constellation_correspondences import (
    MatchingParams,
    find_correspondences,
    weights,
)
from slam_bof.types import Array, Pose

__all__ = ["ConstellationMatch", "camera_motions", "match_constellations"]

MIN_SCORE_RATIO = 0.7
"""Smallest score of a further motion, as a share of the best one."""


@dataclass(frozen=True, slots=True, eq=False)
class ConstellationMatch:
    """A motion that contours of two views agree on.

    Parameters
    ----------
    score
        How much of both views agrees, in [0, 1].
    T_match_query
        (4, 4) pose of the query's camera in the match's.
    inliers
        (M, 2) contours of query and match that agree.
    """

    score: float
    T_match_query: Pose
    inliers: NDArray[np.intp]


def match_constellations(
    query: Constellation, other: Constellation, params: MatchingParams | None = None
) -> list[ConstellationMatch]:
    """Return the motions that may lie between two views, best first.

    There are none where no contours correspond, and several where the scene repeats itself.
    """
    p = params or MatchingParams()
    pairs = find_correspondences(query.bofs, other.bofs, p, query.slice_step_m)
    views = np.zeros(len(pairs.query), np.intp)
    found = find_motions(pairs, views, 1, p, p.max_hypotheses)
    total = np.sqrt(weights(query.bofs).sum() * weights(other.bofs).sum())
    matches: list[ConstellationMatch] = []
    for motion, worth in enumerate(found.worth[:, 0]):
        if worth == 0.0 or worth < MIN_SCORE_RATIO * found.worth[0, 0]:
            break
        columns: tuple[NDArray[Any], ...] = found.motions
        motions = Motions(*(column[motion] for column in columns))
        R_match = other.R_level_camera[None]
        T = camera_motions(motions, query.R_level_camera, R_match)[0]
        agrees = found.motion_of_pair == motion
        inliers = np.stack([pairs.query[agrees], pairs.match[agrees]], axis=1)
        matches.append(ConstellationMatch(float(worth / total), T, inliers))
    return matches


def camera_motions(motions: Motions, R_level_query: Array, R_level_match: Array) -> Array:
    """Return ``T_match_query`` (V, 4, 4) between cameras, of motions between levelled frames.

    ``R_level_query`` (3, 3) and ``R_level_match`` (V, 3, 3) are those of ``Constellation``.
    """
    c, s = np.cos(motions.yaw), np.sin(motions.yaw)
    R, t = np.zeros((len(c), 3, 3)), np.empty((len(c), 3))
    R[:, 0, 0], R[:, 0, 2], R[:, 1, 1], R[:, 2, 0], R[:, 2, 2] = c, -s, 1.0, s, c
    t[:, 0], t[:, 1], t[:, 2] = motions.shift.real, motions.height, motions.shift.imag
    R_match_level = R_level_match.transpose(0, 2, 1)
    T = np.zeros((len(c), 4, 4))
    T[:, :3, :3] = R_match_level @ (R @ R_level_query)
    T[:, :3, 3] = (R_match_level @ t[:, :, None])[:, :, 0]
    T[:, 3, 3] = 1.0
    return T
