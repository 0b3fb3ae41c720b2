"""Votes of single contours for motions of views, many at once, in coarse cells.

One harmonic alone tells the yaw, which is precise enough to find candidates: the second of an
elongated contour, the third of a triangular one, by its phase.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation import N_HARMONICS, PlacedBofs
from slam_bof.bof.constellation_packing import STEPS_PER_M
from slam_bof.bof.posting_lists import Postings
from slam_bof.core import compiled

__all__ = ["MAX_VIEWS", "MotionVotes", "count_votes", "phases"]

HARMONICS = (2, 3)
"""The harmonics whose phase tells the yaw; either does so uniquely within +-60 degrees."""
YAWS = (
    np.arange(256, dtype=np.uint8).view(np.int8) * (2 * np.pi / 256) / np.array(HARMONICS)[:, None]
)
"""Yaw (2, 256) by each harmonic for each difference of phases, of which 256 make a circle."""
TURNS = np.exp(1j * YAWS).reshape(-1)
IS_TOO_FAR = (np.abs(YAWS) > np.radians(66.0)).reshape(-1)
"""Whether a yaw lies beyond the outermost cell that views of one place may have."""
YAW_CELLS = np.rint(YAWS / np.radians(20.0)).reshape(-1) + 3
"""Number of the cell, 20 degrees wide, of each yaw; 3 is that of no yaw."""
PIVOT_M = 2.0
"""Motions turn about a point this far ahead, where contours are, so that an error of the yaw moves
them less."""
CELL_BITS = 6
"""Logarithm to base 2 of the width of a cell in steps: 2^6 steps are half a metre."""
AXIS_BITS = 4
"""Logarithm to base 2 of the number of cells along x and z, which is 16."""
YAW_CELL_BITS = YAW_CELLS.astype(np.uint32) << np.uint32(2 * AXIS_BITS)
MOTION_BITS = 3 + 2 * AXIS_BITS
MAX_VIEWS = 2 ** (32 - MOTION_BITS)
BEYOND = 2 ** (AXIS_BITS + CELL_BITS)
"""Number of steps along x and z from the beginning of the first cell to the end of the last one."""
NOWHERE = 2**14 * (1 + 1j)
"""A place that is far from all cells, in steps."""
FEW_VOTES = 20_000
"""Number of votes above which those that stand alone in their cells are left out, to save time."""
NEIGHBOUR = 0.5
"""Weight of a vote in a neighbouring cell."""


class MotionVotes:
    """The motions that contours of a query vote for.

    Parameters
    ----------
    bofs
        The query's C contours.
    """

    def __init__(self, bofs: PlacedBofs) -> None:
        half = N_HARMONICS
        codes = bofs.codes[:, :half] + 1j * bofs.codes[:, half:]
        strength = np.abs(codes[:, HARMONICS]) * HARMONICS
        self._harmonic = strength.argmax(axis=1)
        own = phases(bofs)[np.arange(len(codes)), self._harmonic]
        # For each phase that another contour may have: the yaw, and where this one comes to lie,
        # plus what makes its cell's number of the distance to the other.
        of_phase = 256 * self._harmonic[:, None] + (own[:, None] - np.arange(256, dtype=np.uint8))
        turned = TURNS.take(of_phase) * (bofs.centroids_m[:, None] - 1j * PIVOT_M) + 1j * PIVOT_M
        turned *= STEPS_PER_M
        middle = 2 ** (AXIS_BITS + CELL_BITS - 1) + 2 ** (CELL_BITS - 1)
        turned -= middle * (1 + 1j)
        turned[IS_TOO_FAR.take(of_phase)] = NOWHERE
        places = np.rint(turned.reshape(-1).view(np.float64))
        self._places = places.astype(np.int16).view(np.int32)
        self._yaw_cells = YAW_CELL_BITS.take(of_phase).reshape(-1)

    def cells(
        self,
        contours: NDArray[np.intp],
        begin: NDArray[np.intp],
        counts: NDArray[np.intp],
        postings: Postings,
    ) -> NDArray[np.uint32]:
        """Return the cell of view and motion of each vote that is for a motion near enough.

        Contours (R,) of the query meet the ``counts`` (R,) postings from ``begin`` (R,) on.
        """
        return _cells(
            contours,
            begin,
            counts,
            self._harmonic,
            self._places,
            self._yaw_cells,
            postings.views,
            postings.places,
            postings.phases,
        )


@compiled
def _cells(
    contours: NDArray[np.intp],
    begin: NDArray[np.intp],
    counts: NDArray[np.intp],
    harmonic: NDArray[np.intp],
    own_places: NDArray[np.int32],
    yaw_cells: NDArray[np.uint32],
    views: NDArray[np.int32],
    places: NDArray[np.int32],
    phases: NDArray[np.uint8],
) -> NDArray[np.uint32]:
    cells = np.empty(counts.sum(), np.uint32)
    n = 0
    for k in range(len(contours)):
        which = harmonic[contours[k]]
        for at in range(begin[k], begin[k] + counts[k]):
            turn = 256 * contours[k] + phases[at, which]
            # Of 16 bits each, so that what is far one way is far the other way as well.
            x = ((places[at] & 0xFFFF) - (own_places[turn] & 0xFFFF)) & 0xFFFF
            z = ((places[at] >> 16) - (own_places[turn] >> 16)) & 0xFFFF
            if (x | z) < BEYOND:
                cell = ((x >> CELL_BITS) << AXIS_BITS) | (z >> CELL_BITS)
                cells[n] = (np.int64(views[at]) << MOTION_BITS) | yaw_cells[turn] | cell
                n += 1
    return cells[:n]


def count_votes(
    cells: NDArray[np.uint32],
    totals: NDArray[np.float32],
    n: int,
    allowed: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the ``n`` views with most votes for one motion, best first, and how many.

    Parameters
    ----------
    cells
        (P,) as of ``MotionVotes.cells``.
    totals
        (V,) weight of all contours of each view; one with few has fewer votes to get.
    allowed
        (V,) leaves some views out.
    """
    cells = np.sort(cells)
    cells, counts = _agreeing(cells, 1 if len(cells) <= FEW_VOTES else 2)
    views = cells >> np.uint32(MOTION_BITS)
    counts *= np.float32(1.0) / np.sqrt(totals[views] + np.float32(5.0))
    if allowed is not None:
        counts[~allowed[views]] = 0.0
    best = np.arange(len(cells))
    if len(best) > 16 * n:
        best = np.sort(np.argpartition(-counts, 16 * n)[: 16 * n])
    total = counts[best]
    for apart in (1, 2**AXIS_BITS, 2 ** (2 * AXIS_BITS)):
        for beside in (cells[best] - np.uint32(apart), cells[best] + np.uint32(apart)):
            at = np.minimum(np.searchsorted(cells, beside), len(cells) - 1)
            total += np.where(cells[at] == beside, np.float32(NEIGHBOUR) * counts[at], 0)
    voted = views[best].astype(np.intp)
    first = np.flatnonzero(np.diff(voted, prepend=-1))
    if len(first) == 0:
        return np.empty(0, np.intp), np.empty(0, np.float32)
    most = np.maximum.reduceat(total, first)
    order = np.argsort(-most, kind="stable")[:n]
    order = order[most[order] > 0]
    return voted[first][order], most[order]


@compiled
def _agreeing(
    cells: NDArray[np.uint32], least: int
) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Return the cells with at least this many votes, and their numbers of votes."""
    found, counts = np.empty_like(cells), np.empty(len(cells), np.float32)
    n = begin = 0
    for end in range(1, len(cells) + 1):
        if end == len(cells) or cells[end] != cells[begin]:
            if end - begin >= least:
                found[n], counts[n] = cells[begin], end - begin
                n += 1
            begin = end
    return found[:n], counts[:n]


def phases(bofs: PlacedBofs) -> NDArray[np.uint8]:
    """Return the phases (C, 2) of the two harmonics, 256 to the circle."""
    half = N_HARMONICS
    codes = bofs.codes[:, :half] + 1j * bofs.codes[:, half:]
    circles = np.angle(codes[:, HARMONICS]) / (2 * np.pi)
    return np.rint(circles * 256).astype(np.int16).astype(np.uint8)
