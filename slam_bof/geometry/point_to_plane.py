"""Point-to-plane ICP of two views: which points lie on which surfaces, and the motion that fits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled
from slam_bof.geometry.projection import NORMAL_STEPS, ViewArrays, by_axis, nearest_pixel, project
from slam_bof.geometry.view_stack import Floats, Indices
from slam_bof.types import Array

__all__ = ["IcpSchedule", "associate", "fill_derivative", "refine", "small_motion"]

PER_STEP = 1.0 / NORMAL_STEPS
MIN_COSINE = 0.6
"""Least cosine between the normals of points that match."""
MIN_SPREAD = 0.02
"""Mean square of normals along a direction, below which it is their noise."""
MAX_LEVERAGE = 10.0
"""A point whose normal is rare has at most this many times the weight of others."""
ROUGH = 0.0025
"""Roughness of depth, in 1/m, from which on the noise of single pixels is what matters. A Kinect or
Xtion has 0.0025 to 0.003, a stereo camera 0.0017 to 0.0019; the smooth depth of a phone has 0.0006.
"""
MIN_INFORMATION = 0.003
"""Steps along directions with a smaller share of the information are shortened."""
MIN_PAIRS = 12
"""A view with fewer pairs is not moved."""


class IcpSchedule(NamedTuple):
    """What each iteration of ICP does."""

    gates_m: Array
    """(n,) largest residual."""
    n_points: Indices
    """(n,) number of points."""
    min_step: float
    """A pair that moves by less, in rad and m, rests until the last iterations."""
    n_final: int
    """Number of iterations at the end in which all pairs move."""


@compiled
def refine(
    views: ViewArrays,
    matches: Indices,
    points: Floats,
    normals: Floats,
    T_match_query: Array,
    schedule: IcpSchedule,
) -> Array:
    """Return ``T_match_query`` (n, 4, 4) after point-to-plane ICP from given ones.

    Parameters
    ----------
    views, matches
        Views, and which of them (n,) are matches.
    points, normals
        (m, 3) each, of the query's surfaces.
    T_match_query
        (n, 4, 4) starts.
    schedule
        What each iteration does.
    """
    refined = T_match_query.copy()
    gates_m, n_points = schedule.gates_m, schedule.n_points
    pairs = np.empty((len(points), 10))
    for k in range(len(matches)):
        moving = True
        for iteration in range(len(gates_m)):
            if not moving and iteration < len(gates_m) - schedule.n_final:
                continue
            n = n_points[iteration]
            gate_m = gates_m[iteration]
            n_pairs = associate(
                views, matches[k], points[:n], normals[:n], refined[k], gate_m, pairs
            )[0]
            step = _solve_step(pairs[:n_pairs], gate_m, views.roughness[matches[k]])
            refined[k] = small_motion(step) @ refined[k]
            moving = np.abs(step).max() > schedule.min_step
    return refined


@compiled
def associate(
    views: ViewArrays,
    match: int,
    points: Floats,
    normals: Floats,
    T_match_query: Array,
    gate_m: float,
    pairs: Array,
) -> tuple[int, NDArray[np.intp]]:
    """Pair points (m, 3) of a query's surfaces with what a match sees at the pixels they fall on.

    Returns the number of pairs, and the indices of their points. The rows of ``pairs`` (m, 10) are
    filled, in the match's frame: point, normal of the query's surface, normal of the match's
    surface, and the residual along the latter.
    """
    T = T_match_query
    indices = np.empty(len(points), np.intp)
    axes = by_axis(points)
    found = np.empty_like(axes)
    project(views, T, axes, found)
    n = 0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        depth_m = found[2, k]
        if depth_m == 0.0:
            continue
        pixel = nearest_pixel(views.width, found[0, k], found[1, k])
        normal_x = views.normals[match, pixel, 0] * PER_STEP
        normal_y = views.normals[match, pixel, 1] * PER_STEP
        normal_z = views.normals[match, pixel, 2] * PER_STEP
        p, q, r = normals[k, 0], normals[k, 1], normals[k, 2]
        facing_x = T[0, 0] * p + T[0, 1] * q + T[0, 2] * r
        facing_y = T[1, 0] * p + T[1, 1] * q + T[1, 2] * r
        facing_z = T[2, 0] * p + T[2, 1] * q + T[2, 2] * r
        # Where nothing is known the normal is zero, and so is the cosine.
        if not normal_x * facing_x + normal_y * facing_y + normal_z * facing_z > MIN_COSINE:
            continue
        moved_x = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        moved_y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        there_m = views.depths_m[match, pixel]
        gap_x = views.rays[pixel, 0] * there_m - moved_x
        gap_y = views.rays[pixel, 1] * there_m - moved_y
        gap_z = there_m - depth_m
        if not gap_x * gap_x + gap_y * gap_y + gap_z * gap_z < 4.0 * gate_m * gate_m:
            continue
        residual_m = gap_x * normal_x + gap_y * normal_y + gap_z * normal_z
        if not abs(residual_m) < gate_m:
            continue
        pairs[n, 0], pairs[n, 1], pairs[n, 2] = moved_x, moved_y, depth_m
        pairs[n, 3], pairs[n, 4], pairs[n, 5] = facing_x, facing_y, facing_z
        pairs[n, 6], pairs[n, 7], pairs[n, 8] = normal_x, normal_y, normal_z
        pairs[n, 9] = residual_m
        indices[n] = k
        n += 1
    return n, indices[:n]


@compiled
def _solve_step(pairs: Array, gate_m: float, roughness: float) -> Array:
    """Return the small motion (6,), rotation first, of weighted least squares.

    Residuals and their derivatives are along the match's normals, but the equations are weighted
    by the query's normals, whose noise is independent (instrumental variables). With the match's
    normals alone, each point would be drawn to the centre of the pixel that it falls on, and the
    noise of normals would count as information. Views do not move along directions that the
    surfaces leave open.
    """
    step = np.zeros(6)
    if len(pairs) < MIN_PAIRS:
        return step
    weights = _weights(pairs, gate_m, roughness)
    centre = np.zeros(3)
    square = 0.0
    for k in range(len(pairs)):
        for i in range(3):
            centre[i] += weights[k] * pairs[k, i]
            square += weights[k] * pairs[k, i] * pairs[k, i]
    radius_m = np.sqrt(max(square - (centre * centre).sum(), 1e-4))
    rows_query, rows_match = np.empty((len(pairs), 6)), np.empty((len(pairs), 7))
    for k in range(len(pairs)):
        x = (pairs[k, 0] - centre[0]) / radius_m
        y = (pairs[k, 1] - centre[1]) / radius_m
        z = (pairs[k, 2] - centre[2]) / radius_m
        fill_derivative(rows_query[k], x, y, z, pairs[k, 3:6], weights[k])
        fill_derivative(rows_match[k], x, y, z, pairs[k, 6:9], 1.0)
        rows_match[k, 6] = pairs[k, 9]
    products = _products(rows_query, rows_match)
    symmetric = 0.5 * (products[:, :6] + products[:, :6].T)
    if not _shortened_step(symmetric, products[:, 6], step):
        values, vectors = np.linalg.eigh(symmetric)
        for j in range(6):
            gain = max(values[j], 0.0) / (values[j] * values[j] + MIN_INFORMATION * MIN_INFORMATION)
            along = 0.0
            for i in range(6):
                along += vectors[i, j] * products[i, 6]
            for i in range(6):
                step[i] += gain * along * vectors[i, j]
    for i in range(3):
        step[i] /= radius_m
    step[3] += centre[1] * step[2] - centre[2] * step[1]
    step[4] += centre[2] * step[0] - centre[0] * step[2]
    step[5] += centre[0] * step[1] - centre[1] * step[0]
    return step


@compiled
def _shortened_step(information: Array, right: Array, step: Array) -> bool:
    """Fill in the step (6,) of equations (6, 6), (6,); return False if they are not definite.

    The step is (A^2 + m^2)^-1 A b, with the least information m: of every eigenvalue l of A,
    l / (l^2 + m^2) instead of 1 / l. Two triangular factors take a tenth of the time of
    eigenvalues, by which negative ones, that are noise, have to be left out.
    """
    factor, squared = np.zeros((6, 6)), np.empty((6, 6))
    is_definite = _factorise(information, factor)
    for i in range(6):
        for j in range(6):
            squared[i, j] = MIN_INFORMATION * MIN_INFORMATION if i == j else 0.0
            for k in range(6):
                squared[i, j] += information[i, k] * information[k, j]
        step[i] = 0.0
        for k in range(6):
            step[i] += information[i, k] * right[k]
    is_definite &= _factorise(squared, factor)
    for i in range(6):
        for k in range(i):
            step[i] -= factor[i, k] * step[k]
        step[i] /= factor[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            step[i] -= factor[k, i] * step[k]
        step[i] /= factor[i, i]
    if not is_definite:
        step[:] = 0.0
    return is_definite


@compiled
def _factorise(symmetric: Array, factor: Array) -> bool:
    """Fill in the lower triangle of Cholesky's factor; return whether the matrix is definite."""
    is_definite = True
    for i in range(6):
        for j in range(i + 1):
            rest = symmetric[i, j]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i == j:
                is_definite &= rest > 0.0
                factor[i, i] = np.sqrt(max(rest, 1e-300))
            else:
                factor[i, j] = rest / factor[j, j]
    return is_definite


@compiled
def _products(a: Array, b: Array) -> Array:
    """Return a'b (6, 7) of rows (m, 6) and (m, 7).

    Sums are written out, since the last digits of BLAS depend on where the arrays lie in memory.
    Seven at a time remain in registers.
    """
    products = np.empty((6, 7))
    for i in range(6):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = 0.0
        for k in range(len(a)):
            s0 += a[k, i] * b[k, 0]
            s1 += a[k, i] * b[k, 1]
            s2 += a[k, i] * b[k, 2]
            s3 += a[k, i] * b[k, 3]
            s4 += a[k, i] * b[k, 4]
            s5 += a[k, i] * b[k, 5]
            s6 += a[k, i] * b[k, 6]
        products[i, 0], products[i, 1], products[i, 2], products[i, 3] = s0, s1, s2, s3
        products[i, 4], products[i, 5], products[i, 6] = s4, s5, s6
    return products


@compiled
def fill_derivative(row: Array, x: float, y: float, z: float, normal: Array, weight: float) -> None:
    """Fill in how a point's distance along a normal changes with its rotation and translation."""
    p, q, r = weight * normal[0], weight * normal[1], weight * normal[2]
    row[0], row[1], row[2] = y * r - z * q, z * p - x * r, x * q - y * p
    row[3], row[4], row[5] = p, q, r


@compiled
def _weights(pairs: Array, gate_m: float, roughness: float) -> Array:
    """Weigh pairs (m, 10) by residual, depth and how rare their normals are; the sum is 1.

    By residual as Geman and McClure do. How rare a normal n is: n' N^-1 n, N the mean square of
    all. The many points on a floor then do not outweigh the few that hold a view sideways. This is
    the normal-space sampling of Rusinkiewicz and Levoy (2001), by weights.

    By depth z, because its noise grows with it: like 1 + z^2, in metres, where depth is rough. The
    depth of a phone is made smooth, and what is left are walls that are bent, above all near ones.
    So the variance of a point grows the less with its depth, the smoother the images are.
    """
    growth = min((roughness / ROUGH) ** 2, 1.0)
    m = len(pairs)
    xx = xy = xz = yy = yz = zz = 0.0
    for k in range(m):
        p, q, r = pairs[k, 3], pairs[k, 4], pairs[k, 5]
        xx, xy, xz = xx + p * p, xy + p * q, xz + p * r
        yy, yz, zz = yy + q * q, yz + q * r, zz + r * r
    spread = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) / m + MIN_SPREAD * np.eye(3)
    rarity = np.linalg.inv(spread) / 3.0
    a, b, c = rarity[0, 0], rarity[1, 1], rarity[2, 2]
    d, e, f = 2.0 * rarity[0, 1], 2.0 * rarity[0, 2], 2.0 * rarity[1, 2]
    weights = np.empty(m)
    for k in range(m):
        p, q, r = pairs[k, 3], pairs[k, 4], pairs[k, 5]
        leverage = p * (a * p + d * q + e * r) + q * (b * q + f * r) + c * r * r
        off = 2.0 * pairs[k, 9] / gate_m
        doubt = 1.0 + off * off
        variance = 1.0 + growth * pairs[k, 2] * pairs[k, 2]
        weights[k] = min(leverage, MAX_LEVERAGE) / (doubt * doubt * variance)
    total = 0.0
    for k in range(m):
        total += weights[k]
    return weights / max(total, 1e-6)


@compiled
def small_motion(tangent: Array) -> Array:
    """Return a small motion as (4, 4): its rotation exactly, the translation as it is."""
    x, y, z = tangent[0], tangent[1], tangent[2]
    angle = np.sqrt(x * x + y * y + z * z)
    a = np.sin(angle) / angle if angle > 1e-6 else 1.0
    b = 2.0 * (np.sin(0.5 * angle) / angle) ** 2 if angle > 1e-6 else 0.5
    T = np.eye(4)
    T[0, 0], T[0, 1], T[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    T[1, 0], T[1, 1], T[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    T[2, 0], T[2, 1], T[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)
    T[:3, 3] = tangent[3:]
    return T
