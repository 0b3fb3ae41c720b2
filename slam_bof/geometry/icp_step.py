"""One step of projective ICP: which points lie on which surfaces, and the motion that fits them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam_bof.geometry.view_stack import Floats, Indices, ViewStack

__all__ = ["Association", "associate", "small_motions", "solve_step"]

MIN_COSINE = 0.6
"""Least cosine between the normals of points that match."""
MIN_SPREAD = np.float32(0.02)
"""Mean square of normals along a direction, below which it is their noise."""
MAX_LEVERAGE = np.float32(10.0)
"""A point whose normal is rare has at most this many times the weight of others."""
MIN_INFORMATION = np.float32(0.003)
"""Steps along directions with a smaller share of the information are shortened."""
MIN_PAIRS = 12
"""A view with fewer pairs is not moved."""


class Association(NamedTuple):
    """Pairs of m points of a query with the surfaces of n matches, in the matches' frames.

    Coordinates lie one after the other in memory.
    """

    points: Floats
    """(n, 3, m)."""
    normals_query: Floats
    """(n, 3, m), of the query's surface."""
    normals_match: Floats
    """(n, 3, m), of the matches' surfaces."""
    residuals_m: Floats
    """(n, m), along the normals of the matches' surfaces."""
    matched: NDArray[np.bool_]
    """(n, m)."""


def associate(
    views: ViewStack,
    query: int,
    matches: Indices,
    T_match_query: Floats,
    *,
    gate_m: np.float32,
    n_points: int,
) -> Association:
    """Pair points of the query's surfaces with what the matches see at the pixels they fall on."""
    points, facing = views.surface(query, n_points)
    projected = views.project_points(points, T_match_query)
    gap, normals = views.surface_at(matches, projected)
    moved = _rotate(T_match_query, points)
    moved += T_match_query[:, :3, 3:]
    gap -= moved
    residuals_m = _dot(gap, normals)
    turned = _rotate(T_match_query, facing)
    # Where nothing is known the normal is zero, and so is the cosine.
    matched = _dot(normals, turned) > MIN_COSINE
    matched &= projected.inside
    matched &= _dot(gap, gap) < 4.0 * gate_m**2
    matched &= np.abs(residuals_m) < gate_m
    return Association(moved, turned, normals, residuals_m, matched)


def solve_step(found: Association, gate_m: np.float32) -> Floats:
    """Return the small motions (n, 6), rotation first, of weighted least squares.

    Residuals and their derivatives are along the match's normals, but the equations are weighted
    by the query's normals, whose noise is independent (instrumental variables). With the match's
    normals alone, each point would be drawn to the centre of the pixel that it falls on, and the
    noise of normals would count as information. Views do not move along directions that the
    surfaces leave open.
    """
    points, normals_query, normals_match, residuals_m, matched = found
    n, _, m = points.shape
    # Geman-McClure, and less for what is far, whose depth is less sure.
    weight = residuals_m * (np.float32(2.0) / gate_m)
    weight *= weight
    weight += np.float32(1.0)
    weight *= weight
    weight *= np.float32(0.2) + np.float32(0.2) * np.square(points[:, 2])
    np.divide(matched, weight, out=weight)
    weight *= _leverage(normals_query, matched)
    total = np.maximum(weight.sum(axis=1), np.float32(1e-6))
    weight /= total[:, None]
    centre = (points @ weight[:, :, None])[..., 0]
    offsets = points - centre[..., None]
    radius_m = np.sqrt(np.maximum((_dot(offsets, offsets) * weight).sum(axis=1), np.float32(1e-4)))
    offsets /= radius_m[:, None, None]
    rows = np.empty((n, 7, m), np.float32)
    rows[:, :3] = _cross(offsets, normals_match)
    rows[:, 3:6] = normals_match
    rows[:, 6] = residuals_m
    instruments = np.concatenate([_cross(offsets, normals_query), normals_query], axis=1)
    instruments *= weight[:, None]
    products = instruments @ rows.transpose(0, 2, 1)
    cross = products[..., :6]
    values, vectors = np.linalg.eigh(0.5 * (cross + cross.transpose(0, 2, 1)))
    gains = np.maximum(values, 0.0) / (np.square(values) + MIN_INFORMATION**2)
    along = vectors.transpose(0, 2, 1) @ products[..., 6:]
    scaled = (vectors @ (gains[..., None] * along))[..., 0]
    scaled *= (matched.sum(axis=1) >= MIN_PAIRS)[:, None]
    turns = scaled[:, :3] / radius_m[:, None]
    shifts = scaled[:, 3:] + _cross(centre[..., None], turns[..., None])[..., 0]
    return np.concatenate([turns, shifts], axis=1)


def small_motions(tangent: Floats) -> Floats:
    """Return small motions as (n, 4, 4): their rotation exactly, the translation as it is."""
    T = np.zeros((len(tangent), 4, 4), np.float32)
    T[:, :3, :3] = Rotation.from_rotvec(tangent[:, :3]).as_matrix()
    T[:, :3, 3] = tangent[:, 3:]
    T[:, 3, 3] = 1.0
    return T


def _leverage(normals: Floats, matched: NDArray[np.bool_]) -> Floats:
    """Weigh points (n, m) by how rare their normals (n, 3, m) are: n' N^-1 n, N their mean square.

    The many points on a floor then do not outweigh the few that hold a view sideways. This is the
    normal-space sampling of Rusinkiewicz and Levoy (2001), by weights.
    """
    kept = normals * matched[:, None]
    count = np.maximum(matched.sum(axis=1), 1)[:, None, None].astype(np.float32)
    spread = kept @ kept.transpose(0, 2, 1) / count
    spread = spread + MIN_SPREAD * np.eye(3, dtype=np.float32)
    leverage = _dot(normals, np.linalg.inv(spread) @ normals)
    return np.asarray(np.minimum(leverage * np.float32(1.0 / 3.0), MAX_LEVERAGE))


def _rotate(T: Floats, vectors: Floats) -> Floats:
    """Return vectors (m, 3) turned by each of (n, 4, 4), coordinate by coordinate: (n, 3, m)."""
    turns = np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 3)
    return np.asarray(turns @ vectors.T).reshape(len(T), 3, -1)


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the dot products (n, m) of vectors (n, 3, m)."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products (n, 3, m) of vectors (n, 3, m)."""
    x, y, z = a.transpose(1, 0, 2)
    u, v, w = b.transpose(1, 0, 2)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
