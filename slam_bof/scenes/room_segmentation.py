"""Rooms of the map: keyframes that stand together and have the same label.

Neighbours in the map vote on each other's label first, so that a keyframe that looks out of the
door, or a bad guess, does not become a room of its own. Then keyframes of one label that are
linked, by standing close together, are a region; regions of very few keyframes go to the one
nearby.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from slam_bof.scenes.hmm_filter import decide
from slam_bof.types import Array, Params, Scene

__all__ = ["Region", "RegionParams", "find_regions"]

Position = tuple[float, float, float]


class RegionParams(Params):
    """What makes keyframes a region."""

    radius_m: float = Field(1.0, gt=0, description="keyframes this close together are linked")
    vote_m: float = Field(0.8, gt=0, description="Gaussian width of the neighbours' vote")
    min_keyframes: int = Field(3, ge=1, description="a smaller region goes to the one nearest")
    min_probability: float = Field(0.4, ge=0, le=1, description="below it a region is unknown")


@dataclass(frozen=True, slots=True)
class Region:
    """A room of the map, by the keyframes that stand in it.

    ``probability`` is their mean of the label's; ``center_m``, ``low_m`` and ``high_m`` are of
    the cameras' positions in the map frame, so that the room's walls are further out.
    """

    id: int
    label: str
    probability: float
    keyframe_ids: tuple[int, ...]
    center_m: Position
    low_m: Position
    high_m: Position


def find_regions(
    scenes: Sequence[Scene | None],
    positions_m: ArrayLike,
    params: RegionParams | None = None,
    *,
    parts: ArrayLike | None = None,
) -> list[Region]:
    """Group keyframes into rooms, in the order in which they were first entered.

    Parameters
    ----------
    scenes
        The (smoothed) label of each of K keyframes, all of the same classes; keyframes without
        are in no region.
    positions_m
        (K, 3) where they are in the map; those not finite are in no region.
    params
        What makes a region.
    parts
        (K,) the part of the map each is in: positions of different parts mean nothing to each
        other.

    Examples
    --------
    >>> see = {"kitchen": np.array([0.9, 0.1]), "office": np.array([0.2, 0.8])}
    >>> labels = ["kitchen"] * 4 + ["office"] * 3
    >>> scenes = [Scene(s, see[s].max(), ("kitchen", "office"), see[s]) for s in labels]
    >>> x_m = np.array([0.0, 0.5, 1.0, 1.5, 4.0, 4.5, 5.0])
    >>> regions = find_regions(scenes, np.stack([x_m, 0 * x_m, 0 * x_m], axis=1))
    >>> [(region.label, region.keyframe_ids, region.center_m[0]) for region in regions]
    [('kitchen', (0, 1, 2, 3), 0.75), ('office', (4, 5, 6), 4.5)]
    """
    p = params or RegionParams()
    positions_m = np.asarray(positions_m, dtype=np.float64).reshape(len(scenes), 3)
    known = np.array([scene is not None for scene in scenes], dtype=bool)
    ids = np.flatnonzero(known & np.isfinite(positions_m).all(axis=1))
    labelled = [scene for i in ids.tolist() if (scene := scenes[i]) is not None]
    if not labelled:
        return []
    where = np.zeros(len(scenes)) if parts is None else np.asarray(parts)
    pairs = _pairs(positions_m[ids], where[ids], max(p.radius_m, 3.0 * p.vote_m))
    votes = _vote(np.array([scene.probabilities for scene in labelled]), pairs, p)
    numbers = _link(votes.argmax(axis=1), pairs, p)
    regions = []
    for id_, number in enumerate(dict.fromkeys(numbers.tolist())):
        inside = numbers == number
        label = decide(votes[inside].mean(axis=0), labelled[0].classes, p.min_probability)
        points = positions_m[ids[inside]]
        regions.append(
            Region(
                id_,
                label.label,
                label.probability,
                tuple(ids[inside].tolist()),
                _position(points.mean(axis=0)),
                _position(points.min(axis=0)),
                _position(points.max(axis=0)),
            )
        )
    return regions


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Keyframes ``i`` and ``j`` (M,) of one part that are near, both ways, themselves too."""

    i: NDArray[np.intp]
    j: NDArray[np.intp]
    apart_m: Array


def _pairs(positions_m: Array, parts: NDArray[np.generic], radius_m: float) -> _Pairs:
    tree = cKDTree(positions_m)
    found = tree.sparse_distance_matrix(tree, radius_m, output_type="ndarray")
    found = found[parts[found["i"]] == parts[found["j"]]]
    return _Pairs(found["i"], found["j"], found["v"])


def _vote(probabilities: Array, pairs: _Pairs, params: RegionParams) -> Array:
    """Return each keyframe's probabilities (K, C) as the mean of its neighbours' and its own."""
    n = len(probabilities)
    weights = np.exp(-0.5 * (pairs.apart_m / params.vote_m) ** 2)
    # Where the camera lingered there are many keyframes: each place counts once.
    weights /= np.bincount(pairs.j, weights, n)[pairs.j]
    voted = sparse.csr_array((weights, (pairs.i, pairs.j)), (n, n)) @ probabilities
    return np.asarray(voted / voted.sum(axis=1, keepdims=True))


def _link(labels: NDArray[np.intp], pairs: _Pairs, params: RegionParams) -> NDArray[np.intp]:
    """Return the number of the region (K,) that each keyframe is in."""
    near = pairs.apart_m <= params.radius_m
    i, j, apart_m = pairs.i[near], pairs.j[near], pairs.apart_m[near]
    alike = labels[i] == labels[j]
    n = len(labels)
    links = sparse.csr_array((np.ones(alike.sum()), (i[alike], j[alike])), (n, n))
    numbers = np.asarray(connected_components(links, directed=False)[1], dtype=np.intp)
    stay: set[int] = set()
    while True:
        kinds, counts = np.unique(numbers, return_counts=True)
        small = [
            (count, kind)
            for kind, count in zip(kinds.tolist(), counts.tolist(), strict=True)
            if count < params.min_keyframes and kind not in stay
        ]
        if not small:
            return numbers
        _, kind = min(small)
        out = np.flatnonzero((numbers[i] == kind) & (numbers[j] != kind))
        if len(out):
            numbers[numbers == kind] = numbers[j[out[apart_m[out].argmin()]]]
        else:
            stay.add(kind)


def _position(point: Array) -> Position:
    x, y, z = point.tolist()
    return x, y, z
