"""A compact log of all edges that ever entered the pose graph."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray
from slam_bof.types import Array, CandidateSource, EdgeKind, Loop

__all__ = ["EdgeColumns", "LoopLog", "edge_shapes"]

ROW = np.dtype(
    [
        ("query_id", np.int32),
        ("match_id", np.int32),
        ("T_match_query", np.float64, (3, 4)),
        ("kind", np.int8),
        ("source", np.int8),
        ("spread", np.float64, (2,)),
    ]
)
KINDS, SOURCES = list(EdgeKind), list(CandidateSource)
TINY_INFORMATION = 1e-9
"""Share of an edge's information that it has in every direction, so that it can be inverted."""


def edge_shapes(information: Array) -> Array:
    """Return covariances (..., 6, 6) up to a factor: the mean information of each becomes 1."""
    mean = np.maximum(np.trace(information, axis1=-2, axis2=-1) / 6.0, np.finfo(float).tiny)
    scaled = information / mean[..., None, None] + TINY_INFORMATION * np.eye(6)
    return np.asarray(np.linalg.inv(scaled))


class EdgeColumns(NamedTuple):
    """Edges (E,) by column: their numbers, the keyframes that they connect, and their lengths.

    ``spreads`` (E, 2) are the sums of the variances of rotation and of translation, by
    ``edge_shapes``.
    """

    numbers: NDArray[np.intp]
    match_ids: NDArray[np.int32]
    query_ids: NDArray[np.int32]
    lengths_m: Array
    spreads: Array


class LoopLog:
    """Stores edges in the order in which they entered the graph, and finds those of a keyframe.

    Edges of culled keyframes have left the graph, so their information is dropped and reads as
    zero. ``map.db`` has all of it.
    """

    def __init__(self) -> None:
        self._rows = GrowingArray((), ROW)
        self._information: dict[int, Array] = {}
        self._of_keyframe: dict[int, tuple[int, ...]] = {}
        self._edges: EdgeColumns | None = None  # those in use, until there are others

    def __len__(self) -> int:
        """Return the number of edges."""
        return len(self._rows)

    def __getitem__(self, number: int) -> Loop:
        """Return the edge that entered the graph as number 0, 1, 2 ..."""
        row = self._rows.rows[number]
        T_match_query = np.eye(4)
        T_match_query[:3] = row["T_match_query"]
        return Loop(
            query_id=int(row["query_id"]),
            match_id=int(row["match_id"]),
            T_match_query=T_match_query,
            information=self._information.get(number, np.zeros((6, 6))),
            kind=KINDS[row["kind"]],
            source=SOURCES[row["source"]],
        )

    def __iter__(self) -> Iterator[Loop]:
        """Iterate over all edges."""
        return (self[number] for number in range(len(self)))

    def append(self, loop: Loop) -> Array:
        """Add an edge; return its covariance (6, 6) up to a factor (``edge_shapes``)."""
        number, self._edges = len(self), None
        kind, source = KINDS.index(EdgeKind(loop.kind)), SOURCES.index(CandidateSource(loop.source))
        shape = edge_shapes(loop.information)
        spread = shape.diagonal().reshape(2, 3).sum(axis=1)
        row = (loop.query_id, loop.match_id, loop.T_match_query[:3], kind, source, spread)
        self._rows.append(np.array(row, ROW))
        self._information[number] = loop.information
        for keyframe_id in (loop.query_id, loop.match_id):
            self._of_keyframe[keyframe_id] = (*self._of_keyframe.get(keyframe_id, ()), number)
        return shape

    def of(self, keyframe_id: int) -> list[Loop]:
        """Return the edges between a keyframe and others that are all in use."""
        return [self[number] for number in self._of_keyframe.get(keyframe_id, ())]

    def edges(self) -> EdgeColumns:
        """Return the edges in use."""
        if self._edges is None:
            numbers = np.fromiter(self._information, np.intp, len(self._information))
            rows = self._rows.rows[numbers]
            lengths_m = np.linalg.norm(rows["T_match_query"][:, :, 3], axis=1)
            self._edges = EdgeColumns(
                numbers, rows["match_id"], rows["query_id"], lengths_m, rows["spread"]
            )
        return self._edges

    def cull(self, keyframe_ids: Collection[int]) -> None:
        """Drop the information of the edges of culled keyframes."""
        gone = {k for keyframe_id in keyframe_ids for k in self._of_keyframe.pop(keyframe_id, ())}
        rows, touched, self._edges = self._rows.rows, set(), None
        for number in gone:
            del self._information[number]
            touched |= {int(rows["query_id"][number]), int(rows["match_id"][number])}
        for keyframe_id in touched & self._of_keyframe.keys():
            kept = tuple(k for k in self._of_keyframe[keyframe_id] if k not in gone)
            self._of_keyframe[keyframe_id] = kept
