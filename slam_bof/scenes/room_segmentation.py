"""Segmentation of the map into rooms: keyframes that stand close together and have one label.

First, neighbours in the map vote on each other's label, so that a keyframe that looks out of the
door, or a wrong label, does not become a room of its own. Then keyframes of one label are linked
where they stand close together, and each connected component is a room. Rooms with very few
keyframes are merged into the nearest other room.
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

from slam_bof.scenes.hmm_filter import most_probable_scene
from slam_bof.types import Array, Params, Scene

__all__ = ["MapRoom", "RoomSegmentationParams", "segment_rooms"]

Position = tuple[float, float, float]


class RoomSegmentationParams(Params):
    """Parameters of the segmentation into rooms."""

    radius_m: float = Field(
        1.0,
        gt=0,
        description="Keyframes of one label are linked to one room if they are at most this far "
        "apart, in metres.",
    )
    vote_m: float = Field(
        0.8,
        gt=0,
        description="Standard deviation of the Gaussian that weighs the votes of neighbouring "
        "keyframes by distance, in metres.",
    )
    min_keyframes: int = Field(
        3,
        ge=1,
        description="Least number of keyframes of a room; a smaller one is merged into the "
        "nearest other room.",
    )
    min_probability: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Least probability of a room's label; a less probable one becomes 'unknown', "
        "as that of a keyframe does below labels.min_probability.",
    )


@dataclass(frozen=True, slots=True)
class MapRoom:
    """A room of the map, by the keyframes that stand in it.

    ``probability`` is the mean of the label's probability over its keyframes. ``center_m``,
    ``low_m`` and ``high_m`` are the mean, minimum and maximum of the camera positions in the map
    frame, in metres; the room's walls are further out.
    """

    id: int
    label: str
    probability: float
    keyframe_ids: tuple[int, ...]
    center_m: Position
    low_m: Position
    high_m: Position


def segment_rooms(
    scenes: Sequence[Scene | None],
    positions_m: ArrayLike,
    params: RoomSegmentationParams | None = None,
    *,
    components: ArrayLike | None = None,
) -> list[MapRoom]:
    """Group keyframes into rooms, in the order in which they were first entered.

    Parameters
    ----------
    scenes
        The (smoothed) label of each of K keyframes, all of the same classes. Keyframes without a
        label are in no room.
    positions_m
        (K, 3) positions in the map; keyframes whose position is not finite are in no room.
    params
        Parameters of the segmentation.
    components
        (K,) component of the pose graph of each keyframe. Positions of different components are
        not comparable. By default all keyframes are in one component.

    Examples
    --------
    >>> p = {"kitchen": np.array([0.9, 0.1]), "office": np.array([0.2, 0.8])}
    >>> labels = ["kitchen"] * 4 + ["office"] * 3
    >>> scenes = [Scene(s, p[s].max(), ("kitchen", "office"), p[s]) for s in labels]
    >>> x_m = np.array([0.0, 0.5, 1.0, 1.5, 4.0, 4.5, 5.0])
    >>> rooms = segment_rooms(scenes, np.stack([x_m, 0 * x_m, 0 * x_m], axis=1))
    >>> [(room.label, room.keyframe_ids, room.center_m[0]) for room in rooms]
    [('kitchen', (0, 1, 2, 3), 0.75), ('office', (4, 5, 6), 4.5)]
    """
    p = params or RoomSegmentationParams()
    positions_m = np.asarray(positions_m, dtype=np.float64).reshape(len(scenes), 3)
    known = np.array([scene is not None for scene in scenes], dtype=bool)
    ids = np.flatnonzero(known & np.isfinite(positions_m).all(axis=1))
    labelled = [scene for i in ids.tolist() if (scene := scenes[i]) is not None]
    if not labelled:
        return []
    where = np.zeros(len(scenes)) if components is None else np.asarray(components)
    pairs = _neighbour_pairs(positions_m[ids], where[ids], max(p.radius_m, 3.0 * p.vote_m))
    votes = _vote(np.array([scene.probabilities for scene in labelled]), pairs, p)
    numbers = _link(votes.argmax(axis=1), pairs, p)
    rooms = []
    for id_, number in enumerate(dict.fromkeys(numbers.tolist())):
        inside = numbers == number
        mean_vote = votes[inside].mean(axis=0)
        scene = most_probable_scene(mean_vote, labelled[0].classes, p.min_probability)
        points = positions_m[ids[inside]]
        rooms.append(
            MapRoom(
                id=id_,
                label=scene.label,
                probability=scene.probability,
                keyframe_ids=tuple(ids[inside].tolist()),
                center_m=_position(points.mean(axis=0)),
                low_m=_position(points.min(axis=0)),
                high_m=_position(points.max(axis=0)),
            )
        )
    return rooms


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Pairs (M,) of neighbouring keyframes ``i`` and ``j`` of one component.

    Each pair is there in both orders, and each keyframe is paired with itself.
    """

    i: NDArray[np.intp]
    j: NDArray[np.intp]
    distance_m: Array


def _neighbour_pairs(
    positions_m: Array, components: NDArray[np.generic], radius_m: float
) -> _Pairs:
    tree = cKDTree(positions_m)
    pairs = tree.sparse_distance_matrix(tree, radius_m, output_type="ndarray")
    pairs = pairs[components[pairs["i"]] == components[pairs["j"]]]
    return _Pairs(pairs["i"], pairs["j"], pairs["v"])


def _vote(probabilities: Array, pairs: _Pairs, params: RoomSegmentationParams) -> Array:
    """Return each keyframe's probabilities (K, C) as the mean of its neighbours' and its own."""
    n = len(probabilities)
    weights = np.exp(-0.5 * (pairs.distance_m / params.vote_m) ** 2)
    # Where the camera lingered there are many keyframes; divide by their density.
    weights /= np.bincount(pairs.j, weights, n)[pairs.j]
    voted = sparse.csr_array((weights, (pairs.i, pairs.j)), (n, n)) @ probabilities
    return np.asarray(voted / voted.sum(axis=1, keepdims=True))


def _link(
    labels: NDArray[np.intp], pairs: _Pairs, params: RoomSegmentationParams
) -> NDArray[np.intp]:
    """Return the number of the room (K,) of each keyframe."""
    near = pairs.distance_m <= params.radius_m
    i, j, distance_m = pairs.i[near], pairs.j[near], pairs.distance_m[near]
    same_label = labels[i] == labels[j]
    n = len(labels)
    links = sparse.csr_array((np.ones(same_label.sum()), (i[same_label], j[same_label])), (n, n))
    numbers = np.asarray(connected_components(links, directed=False)[1], dtype=np.intp)
    isolated: set[int] = set()
    while True:
        rooms, counts = np.unique(numbers, return_counts=True)
        small = [
            (count, room)
            for room, count in zip(rooms.tolist(), counts.tolist(), strict=True)
            if count < params.min_keyframes and room not in isolated
        ]
        if not small:
            return numbers
        _, room = min(small)
        out = np.flatnonzero((numbers[i] == room) & (numbers[j] != room))
        if len(out):
            numbers[numbers == room] = numbers[j[out[distance_m[out].argmin()]]]
        else:
            isolated.add(room)


def _position(point: Array) -> Position:
    x, y, z = point.tolist()
    return x, y, z
