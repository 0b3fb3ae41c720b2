"""Search for a pose that agrees better: from other starts, and along weakly held directions."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from slam_bof.core import compiled
from slam_bof.geometry.observability import MAX_WEAK_INFORMATION, MIN_PAIRS, cross_information
from slam_bof.geometry.point_to_plane import IcpSchedule, associate, refine, small_motion
from slam_bof.geometry.pose_scores import N_SCORE_POINTS, score_pose, score_rows
from slam_bof.geometry.projection import ViewArrays, sampled_by_axis
from slam_bof.geometry.projective_icp import ViewAligner
from slam_bof.geometry.view_stack import Floats
from slam_bof.types import Array, Pose

__all__ = ["search_weak_directions"]

MIN_SCORE_GAIN = 0.01
"""Another pose must agree better by this much to be preferred."""
MIN_VISIBLE_SHARE = 0.8
"""Another pose must keep this share of the overlap, because a small overlap agrees by chance."""
SEARCH_ROUNDS = ((64, 0.15, 4), (32, 0.06, 2))
"""Number of poses tried in a round, their spread in m, and the number aligned of them."""
MAX_WEAK_AXES = 4
"""Number of the weakest directions along which poses are searched for."""
N_COARSE_POINTS = 400
"""Number of points that score a pose of a round, which then is aligned or not."""


def search_weak_directions(
    aligner: ViewAligner,
    query: int,
    match: int,
    T_match_query: Pose,
    starts: Array,
    *,
    seed: int,
) -> Pose:
    """Search for a pose (4, 4) that agrees better; return ``T_match_query`` if there is none.

    Alignment starts again from ``starts`` (n, 4, 4), and then, in rounds, from random poses along
    the weakly held directions of the best pose so far. All of it is one compiled call; of the time
    of many, half would be Python's.
    """
    views = aligner.views
    found, is_better = _search(
        views.arrays(),
        int(views.rows(query)),
        int(views.rows(match)),
        *views.surface(query),
        np.ascontiguousarray(T_match_query),
        np.ascontiguousarray(starts),
        _draws(seed, sum(n for n, *_ in SEARCH_ROUNDS)),
        np.array(SEARCH_ROUNDS),
        aligner.schedule,
        np.array(aligner.params.tolerance),
        min(N_SCORE_POINTS, views.n_points),
        min(N_COARSE_POINTS, views.n_points),
    )
    return found if is_better else T_match_query


@lru_cache(maxsize=4)
def _draws(seed: int, n: int) -> Array:
    """Return a random number for each of n poses and each weak direction."""
    draws = np.random.default_rng(seed).standard_normal((n, MAX_WEAK_AXES))
    draws.setflags(write=False)
    return draws


@compiled
def _search(
    views: ViewArrays,
    query: int,
    match: int,
    points: Floats,
    normals: Floats,
    T_match_query: Array,
    starts: Array,
    draws: Array,
    rounds: Array,
    schedule: IcpSchedule,
    tolerance: Array,
    n_score_points: int,
    n_coarse_points: int,
) -> tuple[Array, bool]:
    """Return the best pose (4, 4) of rows of views, and whether it is another one.

    ``points`` and ``normals`` (m, 3) are of the query's surfaces, ``rounds`` (k, 3) has the number
    of poses, their spread in m and the number aligned; ``draws`` (sum of poses, 4).
    """
    best = T_match_query.copy()
    score, visible_ratio = _scores(views, query, match, best.reshape((1, 4, 4)), n_score_points)
    best_score, least_visible = score[0], MIN_VISIBLE_SHARE * visible_ratio[0]
    is_better, n_drawn = False, 0
    coarse_points = sampled_by_axis(views, query, n_coarse_points)
    for stage in range(-1, len(rounds)):
        tried = starts
        if stage >= 0:
            n, sigma_m, n_aligned = int(rounds[stage, 0]), rounds[stage, 1], int(rounds[stage, 2])
            numbers = sigma_m * draws[n_drawn : n_drawn + n]
            n_drawn += n
            tried = _displaced(views, match, points, normals, best, schedule.gates_m[-1], numbers)
            if len(tried) == 0:  # too few surfaces to hold anything
                break
            coarse = np.empty(n)
            found = np.empty_like(coarse_points)
            for k in range(n):
                coarse[k] = score_pose(views, match, coarse_points, tried[k], tolerance, found)
            tried = tried[np.argsort(-coarse, kind="mergesort")[:n_aligned]]
        if len(tried) == 0:
            continue
        rows = np.full(len(tried), match)
        T = refine(views, rows, points, normals, tried, schedule)
        score, visible_ratio = _scores(views, query, match, T, n_score_points)
        for k in range(len(T)):
            if visible_ratio[k] < least_visible:
                score[k] = -np.inf
        k = int(np.argmax(score))
        if score[k] > best_score + MIN_SCORE_GAIN:
            best, best_score, is_better = T[k].copy(), score[k], True
    return best, is_better


@compiled
def _scores(
    views: ViewArrays, query: int, match: int, T: Array, n_points: int
) -> tuple[Array, Array]:
    """Return score and visible ratio, each (n,), of poses (n, 4, 4) of one pair of rows."""
    T_back = np.zeros_like(T)
    for k in range(len(T)):
        for i in range(3):
            for j in range(3):
                T_back[k, i, j] = T[k, j, i]
                T_back[k, i, 3] -= T[k, j, i] * T[k, j, 3]
        T_back[k, 3, 3] = 1.0
    return score_rows(views, query, np.full(len(T), match), T, T_back, n_points)


@compiled
def _displaced(
    views: ViewArrays,
    match: int,
    points: Floats,
    normals: Floats,
    T: Array,
    gate_m: float,
    numbers: Array,
) -> Array:
    """Return ``T`` (4, 4) displaced along its weakly held directions by numbers (n, 4) in m.

    There is none, (0, 4, 4), if too few points meet a surface. See ``PrincipalDirections``.
    """
    pairs = np.empty((len(points), 10))
    n_pairs, indices = associate(views, match, points, normals, T, gate_m, pairs)
    if n_pairs < MIN_PAIRS:
        return np.empty((0, 4, 4))
    own, facing, met = (
        np.empty((n_pairs, 3)),
        np.empty((n_pairs, 3)),
        np.zeros((n_pairs, 3)),
    )
    for k in range(n_pairs):
        for i in range(3):
            own[k, i] = points[indices[k], i]
            facing[k, i] = normals[indices[k], i]
            for j in range(3):
                met[k, i] += T[j, i] * pairs[k, 6 + j]
    centre, radius_m, cross = cross_information(own, facing, met)
    information, axes = np.linalg.eigh(0.5 * (cross + cross.T))
    n_weak = min(max(int((information < MAX_WEAK_INFORMATION).sum()), 1), MAX_WEAK_AXES)
    displaced = np.empty((len(numbers), 4, 4))
    shift = np.empty(6)
    for k in range(len(numbers)):
        shift[:] = 0.0
        for j in range(n_weak):
            for i in range(6):
                shift[i] += numbers[k, j] * axes[i, j] / (radius_m if i < 3 else 1.0)
        motion = small_motion(shift)
        for i in range(3):
            motion[i, 3] += centre[i]
            for j in range(3):
                motion[i, 3] -= motion[i, j] * centre[j]
        displaced[k] = T @ motion
    return displaced
