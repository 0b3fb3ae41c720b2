"""The motion between two views by consensus of BOF correspondences.

Two BOFs that match are a whole hypothesis of the motion: the shift between their radii is the
yaw, their centroids then give the translation, and their slices the height. So a random sample
of RANSAC (Fischler and Bolles 1981) needs one correspondence only, and all can be tried. The
one that most others agree with wins, and the motion is refined over those that do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof.constellation import N_HARMONICS, Constellation, PlacedBofs
from slam_bof.types import Array, Params, Pose

__all__ = [
    "Correspondences",
    "MatchingParams",
    "PoseHypothesis",
    "find_correspondences",
    "match_constellations",
]

YAW_STEP_DEG = 8
"""Of yaws tried; what lies between is interpolated."""
STEP_HEIGHT_M = 0.1
MIN_AGREEMENT = 0.1
"""By the kernel, of an inlier."""


class MatchingParams(Params):
    """Which contours correspond, and what agrees."""

    max_slices: int = Field(2, ge=0, description="slices apart: gravity and height drift")
    max_size_ratio: float = Field(1.35, gt=1, description="between the largest radii")
    max_mean_difference: float = Field(0.12, gt=0, description="of radii divided by the largest")
    min_similarity: float = Field(0.9, gt=0, lt=1, description="correlation of the radii")
    max_yaw_deg: float = Field(60.0, gt=0, le=180, description="between the two views")
    sigma_yaw_deg: float = Field(6.0, gt=0, description="kernel of agreement")
    sigma_m: float = Field(0.2, gt=0, description="in x and z")
    sigma_height_m: float = Field(0.06, gt=0, description="in height")
    max_distance_m: float = Field(3.0, gt=0, description="between the two cameras")
    max_hypotheses: int = Field(3, gt=0, description="of a pair")
    min_score_ratio: float = Field(0.7, gt=0, le=1, description="of the next to the best")


class Correspondences(NamedTuple):
    """Pairs (M,) of a contour of the query and one of the matches, with the motion of each.

    ``query_m`` and ``match_m`` (complex ``x + i z``) are their centroids. ``yaw`` (rad), ``shift``
    (complex, m) and ``height`` (m) take the query's levelled frame to the match's; ``weight`` is
    what a pair counts.
    """

    query: NDArray[np.intp]
    match: NDArray[np.intp]
    query_m: NDArray[np.complex64]
    match_m: NDArray[np.complex64]
    yaw: NDArray[np.float32]
    shift: NDArray[np.complex64]
    height: NDArray[np.float32]
    weight: NDArray[np.float32]

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Correspondences:
        """Return some rows."""
        columns: tuple[NDArray[Any], ...] = self
        return Correspondences(*(column[rows] for column in columns))


@dataclass(frozen=True, slots=True, eq=False)
class PoseHypothesis:
    """A motion that contours of two views agree on.

    Parameters
    ----------
    score
        How much of both views agrees, in [0, 1] but for rounding.
    T_match_query
        (4, 4), between the cameras.
    inliers
        (M, 2) contours of query and match that agree, each of the query once.
    """

    score: float
    T_match_query: Pose
    inliers: NDArray[np.intp]


def match_constellations(
    query: Constellation, other: Constellation, params: MatchingParams | None = None
) -> list[PoseHypothesis]:
    """Return the motions that may lie between two views, best first.

    None where no contours correspond; several where the scene repeats itself.
    """
    p = params or MatchingParams()
    pairs = find_correspondences(query.bofs, other.bofs, p)
    total = np.sqrt(weights(query.bofs).sum() * weights(other.bofs).sum())
    hypotheses: list[PoseHypothesis] = []
    while len(pairs.yaw) and len(hypotheses) < p.max_hypotheses:
        kernel = _kernel(pairs, p)
        density = kernel @ pairs.weight
        best = int(density.argmax())
        score = float(once_each(pairs.query, kernel[best] * pairs.weight) / total)
        if hypotheses and score < p.min_score_ratio * hypotheses[0].score:
            break
        motion, inliers = refine(pairs, kernel[best], p)
        T = to_cameras(motion, query.R_level_camera, other.R_level_camera)
        both = np.stack([pairs.query[inliers], pairs.match[inliers]], axis=1)
        hypotheses.append(PoseHypothesis(score, T, both))
        pairs = pairs.take(kernel[best] < MIN_AGREEMENT)
    return hypotheses


def find_correspondences(
    query: PlacedBofs, others: PlacedBofs, params: MatchingParams
) -> Correspondences:
    """Return the pairs of contours that correspond."""
    p = params
    near = np.abs(query.slices[:, None] - others.slices) <= p.max_slices
    log_ratio = np.float32(np.log(p.max_size_ratio))
    near &= np.abs(query.log_radii[:, None] - others.log_radii) < log_ratio
    near &= np.abs(query.means[:, None] - others.means) < np.float32(p.max_mean_difference)
    a, b = np.nonzero(near)
    return correspond(query, others, a, b, p)


def correspond(
    query: PlacedBofs,
    others: PlacedBofs,
    a: NDArray[np.intp],
    b: NDArray[np.intp],
    params: MatchingParams,
) -> Correspondences:
    """Return those of pairs (M,) of contours whose BOFs are similar, turned by up to some yaw.

    ``a`` (M,) are contours of the query, ascending, and ``b`` (M,) of the others.
    """
    p = params
    yaws = _yaws(p.max_yaw_deg)
    turned = _turn(query.codes, yaws)
    similarity = np.empty((len(yaws), len(a)), np.float32)
    bounds = np.searchsorted(a, np.arange(len(query.codes) + 1))
    for k, (start, stop) in enumerate(pairwise(bounds.tolist())):
        similarity[:, start:stop] = turned[k] @ others.codes[b[start:stop]].T
    kept = np.flatnonzero(similarity.max(axis=0, initial=-1.0) > p.min_similarity)
    a, b, similarity = a[kept], b[kept], similarity[:, kept]
    best, columns = similarity.argmax(axis=0), np.arange(len(a))
    highest = similarity[best, columns]
    # A parabola through the three best.
    middle = np.clip(best, 1, len(yaws) - 2)
    left, top, right = (similarity[middle + k, columns] for k in (-1, 0, 1))
    bend = np.minimum(left - 2 * top + right, np.float32(-1e-6))
    beside = np.clip(0.5 * (left - right) / bend, -1.0, 1.0)
    yaw = (yaws[middle] + beside * (yaws[1] - yaws[0])).astype(np.float32)
    query_m, match_m = query.centroids_m[a], others.centroids_m[b]
    shift = match_m - np.exp(1j * yaw).astype(np.complex64) * query_m
    height = (others.slices[b] - query.slices[a].astype(np.int16)) * np.float32(STEP_HEIGHT_M)
    weight = np.sqrt(weights(query)[a] * weights(others)[b])
    weight *= (highest - np.float32(p.min_similarity)) / np.float32(1 - p.min_similarity)
    near = np.flatnonzero(np.abs(shift) < p.max_distance_m)
    pairs = Correspondences(a, b, query_m, match_m, yaw, shift, height.astype(np.float32), weight)
    return pairs.take(near)


def weights(bofs: PlacedBofs) -> NDArray[np.float32]:
    """Return what contours (C,) count: long ones more, but not by as much as they are longer."""
    return np.sqrt(bofs.lengths_m)


def once_each(query: NDArray[np.intp], worth: NDArray[np.float32]) -> np.float32:
    """Add up what each contour of the query is worth by its best partner."""
    best = np.zeros(query.max() + 1, np.float32)
    np.maximum.at(best, query, worth)
    return np.float32(best.sum())


def features(pairs: Correspondences, params: MatchingParams) -> NDArray[np.float32]:
    """Return motions (M, 4) in units of the kernel."""
    return np.stack(
        [
            pairs.yaw * np.float32(1 / np.radians(params.sigma_yaw_deg)),
            pairs.shift.real * np.float32(1 / params.sigma_m),
            pairs.shift.imag * np.float32(1 / params.sigma_m),
            pairs.height * np.float32(1 / params.sigma_height_m),
        ],
        axis=1,
    )


class Motion(NamedTuple):
    """Of a levelled frame in another: yaw (rad), shift ``x + i z`` (m) and height (m)."""

    yaw: float
    shift: complex
    height: float


def refine(
    pairs: Correspondences, agreement: NDArray[np.float32], params: MatchingParams
) -> tuple[Motion, NDArray[np.intp]]:
    """Fit a motion to pairs (M,) that agree, each of the query by its best; also return these.

    The yaw is the most likely by both the centroids (Kabsch 1976) and the pairs' own yaws.
    """
    worth = agreement * pairs.weight
    order = np.lexsort((-worth, pairs.query))
    first = order[np.diff(pairs.query[order], prepend=-1) > 0]
    inliers = first[agreement[first] > MIN_AGREEMENT]
    w = worth[inliers] / worth[inliers].sum()
    query_m, match_m = pairs.query_m[inliers], pairs.match_m[inliers]
    query_mean, match_mean = w @ query_m, w @ match_m
    by_centroids = w @ ((query_m - query_mean).conj() * (match_m - match_mean))
    by_yaws = w @ np.exp(1j * pairs.yaw[inliers])
    yaw = np.angle(
        by_centroids / params.sigma_m**2 + by_yaws / np.radians(params.sigma_yaw_deg) ** 2
    )
    shift = match_mean - np.exp(1j * yaw) * query_mean
    return Motion(float(yaw), complex(shift), float(w @ pairs.height[inliers])), inliers


def to_cameras(motion: Motion, R_level_query: Array, R_level_match: Array) -> Pose:
    """Return ``T_match_query`` (4, 4) between cameras, of a motion between levelled frames."""
    T, c, s = np.eye(4), np.cos(motion.yaw), np.sin(motion.yaw)
    R = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    T[:3, :3] = R_level_match.T @ R @ R_level_query
    T[:3, 3] = R_level_match.T @ (motion.shift.real, motion.height, motion.shift.imag)
    return T


def _kernel(pairs: Correspondences, params: MatchingParams) -> NDArray[np.float32]:
    """Return how far each two pairs agree, (M, M)."""
    at = features(pairs, params)
    length2 = (at * at).sum(axis=1)
    distance2 = length2[:, None] + length2 - 2.0 * (at @ at.T)
    return np.asarray(np.exp(np.minimum(-0.5 * distance2, 0.0)))


@lru_cache(maxsize=4)
def _yaws(max_yaw_deg: float) -> NDArray[np.float32]:
    """Return the yaws (Y,) tried."""
    most = int(max_yaw_deg / YAW_STEP_DEG) * YAW_STEP_DEG
    return np.radians(np.arange(-most, most + 1, YAW_STEP_DEG)).astype(np.float32)


def _turn(codes: NDArray[np.float32], yaws: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return codes (C, Y, 2 N_HARMONICS) of contours (C,) turned by each yaw."""
    half = N_HARMONICS
    turn = np.exp(-1j * np.outer(yaws, np.arange(half))).astype(np.complex64)
    turned = (codes[:, :half] + 1j * codes[:, half:])[:, None] * turn
    return np.concatenate([turned.real, turned.imag], axis=-1)
