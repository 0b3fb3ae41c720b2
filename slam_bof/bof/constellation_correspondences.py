"""Which contours of two views correspond, and the motion that each pair means.

Two BOFs that match are a whole hypothesis of the motion: the shift between their radii is the
yaw, their centroids then give the translation, and their slices the height.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof.constellation import N_HARMONICS, PlacedBofs
from slam_bof.core import compiled
from slam_bof.types import Params

__all__ = ["Correspondences", "MatchingParams", "find_correspondences", "weights"]

YAW_STEP_DEG = 8
"""Step between the yaws that are tried; the best is interpolated between them."""


class MatchingParams(Params):
    """Which contours correspond, and what agrees."""

    max_slices: int = Field(
        2,
        ge=0,
        description="Largest difference of slice numbers between two contours that match.",
    )
    max_size_ratio: float = Field(
        1.35,
        gt=1,
        description="Largest ratio of the largest radii of two contours that match.",
    )
    max_mean_difference: float = Field(
        0.12,
        gt=0,
        description="Largest difference of the mean radii, each divided by the largest radius.",
    )
    min_similarity: float = Field(
        0.9,
        gt=0,
        lt=1,
        description="Smallest circular correlation of the radii of two contours that match.",
    )
    max_yaw_deg: float = Field(
        60.0,
        gt=0,
        le=180,
        description="Largest yaw between two views, in degrees.",
    )
    max_distance_m: float = Field(
        3.0,
        gt=0,
        description="Largest horizontal distance between two cameras, in m.",
    )
    sigma_yaw_deg: float = Field(
        6.0,
        gt=0,
        description="Width of the voting kernel in yaw, in degrees.",
    )
    sigma_m: float = Field(0.2, gt=0, description="Width of the voting kernel in x and z, in m.")
    sigma_height_m: float = Field(
        0.06,
        gt=0,
        description="Width of the voting kernel in height, in m.",
    )
    max_hypotheses: int = Field(
        3,
        gt=0,
        description="Largest number of pose hypotheses for a pair of views.",
    )


class Correspondences(NamedTuple):
    """Pairs (M,) of a contour of the query and one of the matches, with the motion of each.

    ``query_m`` and ``match_m`` (complex ``x + i z``) are their centroids. ``yaw`` (rad), ``shift``
    (complex, m) and ``height`` (m) take the query's levelled frame to the match's, ``turn`` is
    exp(i yaw), and ``weight`` is what a pair counts.
    """

    query: NDArray[np.intp]
    match: NDArray[np.intp]
    query_m: NDArray[np.complex64]
    match_m: NDArray[np.complex64]
    yaw: NDArray[np.float32]
    turn: NDArray[np.complex64]
    shift: NDArray[np.complex64]
    height: NDArray[np.float32]
    weight: NDArray[np.float32]

    def take(self, rows: NDArray[np.integer[Any]]) -> Correspondences:
        """Return some rows."""
        columns: tuple[NDArray[Any], ...] = self
        return Correspondences(*(column.take(rows) for column in columns))


def find_correspondences(
    query: PlacedBofs, others: PlacedBofs, params: MatchingParams, slice_step_m: float
) -> Correspondences:
    """Return the pairs of contours that correspond, in order of the query's.

    ``slice_step_m`` is the height from one slice to the next, by which both were described.
    """
    a, b = _candidates(query, others, params)
    yaws = _yaws(params.max_yaw_deg)
    turned = _turn(query.codes, yaws)
    codes = others.codes.take(b, axis=0)
    similarity = np.empty((len(a), len(yaws)), np.float32)
    bounds = np.searchsorted(a, np.arange(len(query.codes) + 1))
    for k, (start, stop) in enumerate(pairwise(bounds.tolist())):
        np.matmul(codes[start:stop], turned[k], out=similarity[start:stop])
    kept, yaw, highest = _peaks(similarity, yaws, np.float32(params.min_similarity))
    a, b = a.take(kept), b.take(kept)
    query_m, match_m = query.centroids_m.take(a), others.centroids_m.take(b)
    turn = np.cos(yaw) + 1j * np.sin(yaw)
    shift = match_m - turn * query_m
    slices_up = others.slices.take(b) - query.slices.take(a).astype(np.int16)
    height = slices_up * np.float32(slice_step_m)
    weight = np.sqrt(weights(query).take(a) * weights(others).take(b))
    weight *= (highest - np.float32(params.min_similarity)) / np.float32(1 - params.min_similarity)
    pairs = Correspondences(a, b, query_m, match_m, yaw, turn, shift, height, weight)
    return pairs.take(np.flatnonzero(np.abs(shift) < params.max_distance_m))


def weights(bofs: PlacedBofs) -> NDArray[np.float32]:
    """Return what contours (C,) count: long ones more, but not by as much as they are longer."""
    return np.sqrt(bofs.lengths_m)


def _candidates(
    query: PlacedBofs, others: PlacedBofs, params: MatchingParams
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs (M,), (M,) of contours of about one height, size and mean radius."""
    order = np.argsort(others.slices, kind="stable")
    slices = others.slices.take(order)
    low = np.searchsorted(slices, query.slices - params.max_slices)
    high = np.searchsorted(slices, query.slices + params.max_slices, side="right")
    sizes = query.log_radii, others.log_radii.take(order)
    means = query.means, others.means.take(order)
    max_log_ratio = np.float32(np.log(params.max_size_ratio))
    max_difference = np.float32(params.max_mean_difference)
    a, at = _near_pairs(low, high, sizes, means, max_log_ratio, max_difference)
    return a, order.take(at)


@compiled
def _near_pairs(
    low: NDArray[np.intp],
    high: NDArray[np.intp],
    sizes: tuple[NDArray[np.float32], NDArray[np.float32]],
    means: tuple[NDArray[np.float32], NDArray[np.float32]],
    max_size: np.float32,
    max_mean: np.float32,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which contours of the query (C,) are near which of the others from low to high."""
    n_pairs = (high - low).sum()
    a, b = np.empty(n_pairs, np.intp), np.empty(n_pairs, np.intp)
    n = 0
    for k in range(len(low)):
        for at in range(low[k], high[k]):
            a[n], b[n] = k, at
            is_near = abs(sizes[0][k] - sizes[1][at]) < max_size
            n += is_near & (abs(means[0][k] - means[1][at]) < max_mean)
    return a[:n], b[:n]


@compiled
def _peaks(
    similarity: NDArray[np.float32], yaws: NDArray[np.float32], least: np.float32
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Return the pairs (K,) of which a similarity (M, Y) is above the least.

    Also where each is highest, by a parabola through three, and how high.
    """
    n_pairs, n_yaws = similarity.shape
    kept = np.empty(n_pairs, np.intp)
    yaw, highest = np.empty(n_pairs, np.float32), np.empty(n_pairs, np.float32)
    half, double = np.float32(0.5), np.float32(2.0)
    n = 0
    for pair in range(n_pairs):
        along = similarity[pair]
        best = 0
        for k in range(1, n_yaws):
            if along[k] > along[best]:
                best = k
        if along[best] > least:
            middle = min(max(best, 1), n_yaws - 2)
            left, top, right = along[middle - 1], along[middle], along[middle + 1]
            bend = min(left - double * top + right, np.float32(-1e-6))
            beside = min(max(half * (left - right) / bend, np.float32(-1.0)), np.float32(1.0))
            kept[n], highest[n] = pair, along[best]
            yaw[n] = yaws[middle] + beside * (yaws[1] - yaws[0])
            n += 1
    return kept[:n], yaw[:n], highest[:n]


@lru_cache(maxsize=4)
def _yaws(max_yaw_deg: float) -> NDArray[np.float32]:
    """Return the yaws (Y,) tried, at least three."""
    n = max(1, int(max_yaw_deg / YAW_STEP_DEG))
    return np.radians(np.arange(-n, n + 1) * YAW_STEP_DEG).astype(np.float32)


def _turn(codes: NDArray[np.float32], yaws: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return codes (C, 2 N_HARMONICS, Y) of contours (C,) turned by each yaw."""
    half = N_HARMONICS
    turn = np.exp(-1j * np.outer(np.arange(half), yaws)).astype(np.complex64)
    turned = (codes[:, :half] + 1j * codes[:, half:])[:, :, None] * turn
    return np.concatenate([turned.real, turned.imag], axis=1)
