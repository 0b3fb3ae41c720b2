"""Votes of single contours for motions of views, many at once, in coarse cells.

The yaw is told by one harmonic alone, which serves to find candidates: the phase of an elongated
contour's second, or of a triangular one's third.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation import N_HARMONICS, PlacedBofs
from slam_bof.bof.constellation_packing import STEPS_PER_M
from slam_bof.bof.posting_lists import Postings

__all__ = ["MAX_VIEWS", "MotionVotes", "count_votes", "phases"]

HARMONICS = (2, 3)
"""Either tells the yaw uniquely within +-60 degrees."""
YAWS = (
    np.arange(256, dtype=np.uint8).view(np.int8) * (2 * np.pi / 256) / np.array(HARMONICS)[:, None]
)
"""Told by each harmonic, of a difference of phases in 256 to the circle."""
TURNS = np.exp(1j * YAWS).reshape(-1)
IS_TOO_FAR = (np.abs(YAWS) > np.radians(66.0)).reshape(-1)
YAW_CELLS = np.rint(YAWS / np.radians(20.0)).reshape(-1) + 3
PIVOT_M = 2.0
"""Turns are about a point so far ahead, where contours are, so that a wrong yaw moves them less."""
CELL_BITS = 6
"""A cell is 2^6 steps wide, half a metre."""
AXIS_BITS = 4
"""16 cells along x and z."""
YAW_CELL_BITS = YAW_CELLS.astype(np.uint32) << np.uint32(2 * AXIS_BITS)
MOTION_BITS = 3 + 2 * AXIS_BITS
MAX_VIEWS = 2 ** (32 - MOTION_BITS)
FAR = np.uint32(0x10001 * (0xFFFF & -(2 ** (AXIS_BITS + CELL_BITS))))
"""The bits of a place, relative to the first cell, that only one beyond the last cell has."""
ALONG_X = np.uint32((2**AXIS_BITS - 1) << AXIS_BITS)
NOWHERE = 2**14 * (1 + 1j)
"""Steps away from anything."""
NEIGHBOUR = 0.5
"""What a vote in a cell beside counts."""


class MotionVotes:
    """What contours of a query vote for.

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
        begin = begin - (np.cumsum(counts) - counts)
        at = np.repeat(2 * begin + self._harmonic[contours], counts)
        at += np.arange(0, 2 * len(at), 2)
        turn = np.repeat(256 * contours, counts)
        turn += postings.phases.reshape(-1)[at]
        at >>= 1
        moved = postings.places[at].view(np.int16) - self._places[turn].view(np.int16)
        moved = moved.view(np.uint32)
        near = np.flatnonzero((moved & FAR) == 0)
        moved = moved[near]
        cell = postings.views[at[near]].view(np.uint32) << np.uint32(MOTION_BITS)
        cell |= self._yaw_cells[turn[near]]
        cell |= (moved >> np.uint32(CELL_BITS - AXIS_BITS)) & ALONG_X
        cell |= moved >> np.uint32(16 + CELL_BITS)
        return np.asarray(cell)


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
    # What stands alone agrees with nothing.
    again = np.flatnonzero(cells[1:] == cells[:-1])
    first = np.flatnonzero(np.diff(again, prepend=-2) != 1)
    counts = (np.diff(first, append=len(again)) + 1).astype(np.float32)
    cells = cells[again[first]]
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


def phases(bofs: PlacedBofs) -> NDArray[np.uint8]:
    """Return the phases (C, 2) of the two harmonics, 256 to the circle."""
    half = N_HARMONICS
    codes = bofs.codes[:, :half] + 1j * bofs.codes[:, half:]
    circles = np.angle(codes[:, HARMONICS]) / (2 * np.pi)
    return np.rint(circles * 256).astype(np.int16).astype(np.uint8)
