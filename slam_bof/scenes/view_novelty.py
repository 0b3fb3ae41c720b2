"""How much of what the camera has seen was new, which limits how certain a smoothed label can be.

Neighbouring keyframes see the same surfaces, and a classifier that is wrong about them is wrong
each time. The hidden Markov model counts every keyframe, which finds the most probable scene. How
probable it is follows from the mean of the nearby views that it assigns to the same scene: a
hundred views of one wall count as one, and many views of the same place as two or three.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from slam_bof.types import Array

__all__ = ["PATH_M", "novelties", "novelty", "path_sums", "pooled"]

OVERLAP_M = 1.0
"""Distance between two cameras, with the same viewing direction, at which the overlap of their
views has fallen to 37 %."""
OVERLAP_RAD = np.radians(30.0)
"""Angle between two viewing directions, from the same place, at which it has. The overlap falls
exponentially, so that the sum of novelties along a path does not depend on the number of views."""
UNPLACED_NOVELTY = 0.1
"""Novelty of a view whose position is unknown."""
PATH_M = 4.0
"""Views are counted over about this length of the path, in metres."""


def novelty(position_m: Array, axis: Array, positions_m: Array, axes: Array) -> float:
    """Return the share of a view that no earlier view has seen, from 0 to 1.

    Parameters
    ----------
    position_m, axis
        (3,) position and viewing direction (unit vector) of the view.
    positions_m, axes
        (N, 3) those of earlier views, in the same frame; ones that are not finite are left out.

    Examples
    --------
    >>> here, ahead = np.zeros(3), np.array([0.0, 0, 1])
    >>> novelty(here, ahead, here[None], ahead[None])
    0.0
    >>> novelty(here, ahead, here[None], -ahead[None]) > 0.99
    True
    """
    if not np.isfinite(position_m).all():
        return UNPLACED_NOVELTY
    distances_m = np.linalg.norm(positions_m - position_m, axis=1)
    angles_rad = np.arccos(np.clip(axes @ axis, -1.0, 1.0))
    apart = np.hypot(distances_m / OVERLAP_M, angles_rad / OVERLAP_RAD)
    return float(1.0 - np.exp(-np.min(apart[np.isfinite(apart)], initial=np.inf)))


def novelties(positions_m: Array, axes: Array, components: NDArray[np.generic]) -> Array:
    """Return the novelty (K,) of each of K views among the earlier ones of its component.

    Parameters
    ----------
    positions_m, axes
        (K, 3) positions and viewing directions, in the order of time.
    components
        (K,) positions of different components are not comparable.
    """
    out = np.ones(len(positions_m))
    for k in range(len(positions_m)):
        before = components[:k] == components[k]
        out[k] = novelty(positions_m[k], axes[k], positions_m[:k][before], axes[:k][before])
    return out


def path_sums(values: Array, steps_m: Array) -> Array:
    """Return the sums (K, ...) of values (K, ...) along a path, weighted by exp(-way / PATH_M).

    ``steps_m`` (K - 1,) are the lengths of the path between consecutive values.

    Examples
    --------
    >>> path_sums(np.array([1.0, 2.0, 3.0]), np.zeros(2)).round(3).tolist()
    [6.0, 6.0, 6.0]
    >>> path_sums(np.array([1.0, 2.0]), np.array([100.0])).round(3).tolist()
    [1.0, 2.0]
    """
    decay = np.exp(-steps_m / PATH_M)
    before, after = values.copy(), values.copy()
    for k in range(1, len(values)):
        before[k] += decay[k - 1] * before[k - 1]
    for k in range(len(values) - 2, -1, -1):
        after[k] += decay[k] * after[k + 1]
    return np.asarray(before + after - values)


def pooled(logs: Array, n_new: Array, n_views: Array, view_correlation: float) -> Array:
    """Return the probabilities (..., C) of a scene by several views of it.

    Views of one room err together, as members of a cluster do: ``n`` of them weigh as much as
    ``n / (1 + (n - 1) view_correlation)`` independent ones (the design effect of L. Kish, "Survey
    Sampling", 1965). No number of views counts as more than ``1 / view_correlation``.

    Parameters
    ----------
    logs
        (..., C) sums of the logarithms of the views' probabilities.
    n_new, n_views
        (...) sum of the views' novelties, and number of views.
    view_correlation
        Correlation of what two different views of a place say, from 0 to 1.

    Examples
    --------
    >>> logs = 100 * np.log([0.8, 0.2])
    >>> pooled(logs, np.array(1.0), np.array(100.0), 0.4).round(3).tolist()
    [0.8, 0.2]
    >>> pooled(logs, np.array(1e9), np.array(100.0), 0.5).round(3).tolist()  # as two views
    [0.941, 0.059]
    """
    n = np.maximum(n_new, 1.0)
    n_independent = n / (1.0 + (n - 1.0) * view_correlation)
    weights = n_independent / np.maximum(n_views, 1e-9)
    return np.asarray(softmax(logs * weights[..., None], axis=-1))
