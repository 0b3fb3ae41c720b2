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

__all__ = ["MotionVotes", "count_votes", "phases"]

HARMONICS = (2, 3)
"""Either tells the yaw uniquely within +-60 degrees."""
YAWS = (
    np.arange(256, dtype=np.uint8).view(np.int8) * (2 * np.pi / 256) / np.array(HARMONICS)[:, None]
)
"""Told by each harmonic, of a difference of phases in 256 to the circle."""
TURNS = np.exp(1j * YAWS)
MAX_YAW_RAD = np.radians(66.0)
YAW_CELL_RAD = np.radians(20.0)
PIVOT_M = 2.0
"""Turns are about a point so far ahead, where contours are, so that a wrong yaw moves them less."""
CELL_BITS = 6
"""A cell is 2^6 steps wide, half a metre."""
AXIS_BITS = 4
"""16 cells along x and z."""
MOTION_BITS = 3 + 2 * AXIS_BITS
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
        self._phase = phases(bofs)[np.arange(len(codes)), self._harmonic]
        yaw = YAWS[self._harmonic]
        turned = TURNS[self._harmonic] * (bofs.centroids_m[:, None] - 1j * PIVOT_M) + 1j * PIVOT_M
        turned *= STEPS_PER_M
        # Of all 256 differences between two phases: where the contour comes to lie, plus what
        # makes its cell's number of the distance to another.
        middle = 2 ** (AXIS_BITS + CELL_BITS - 1) + 2 ** (CELL_BITS - 1)
        turned -= middle * (1 + 1j)
        turned[np.abs(yaw) > MAX_YAW_RAD] = NOWHERE
        self._x = np.rint(turned.real).astype(np.int16).reshape(-1)
        self._z = np.rint(turned.imag).astype(np.int16).reshape(-1)
        self._yaw_cells = (np.rint(yaw / YAW_CELL_RAD) + 3).astype(np.int64).reshape(-1)

    def cells(
        self, contours: NDArray[np.intp], rows: NDArray[np.intp], postings: Postings
    ) -> NDArray[np.int64]:
        """Return the cell of view and motion of each vote that is for a motion near enough.

        Contours (P,) of the query meet those of ``rows`` (P,) of the postings.
        """
        turn = self._harmonic[contours]
        turn += 2 * rows
        difference = self._phase[contours] - postings.phases.reshape(-1)[turn]
        np.multiply(contours, 256, out=turn)
        turn += difference
        x = postings.x[rows] - self._x[turn]
        z = postings.z[rows] - self._z[turn]
        # Of unsigned numbers, those below zero are the largest.
        wide = 2 ** (AXIS_BITS + CELL_BITS)
        near = np.flatnonzero((x.view(np.uint16) < wide) & (z.view(np.uint16) < wide))
        cell = postings.views[rows[near]].astype(np.int64) << 3
        cell |= self._yaw_cells[turn[near]]
        for along in (x, z):
            cell <<= AXIS_BITS
            cell |= along[near] >> CELL_BITS
        return cell


def count_votes(
    cells: NDArray[np.int64], worth: NDArray[np.float32], n: int
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the ``n`` views with most votes for one motion, best first, and how many.

    Parameters
    ----------
    cells
        (P,) as of ``MotionVotes.cells``.
    worth
        (V,) what a vote for each view counts.
    """
    cells = np.sort(cells)
    # What stands alone agrees with nothing.
    ends = np.flatnonzero(np.append(cells[1:] != cells[:-1], True)) + 1
    starts = np.append(0, ends)[: len(ends)]
    counts = ends - starts
    several = np.flatnonzero(counts > 1)
    cells, counts = cells[starts[several]], counts[several].astype(np.float32)
    counts *= worth[cells >> MOTION_BITS]
    best = np.arange(len(cells))
    if len(best) > 16 * n:
        best = np.sort(np.argpartition(-counts, 16 * n)[: 16 * n])
    total = counts[best]
    for apart in (1, 2**AXIS_BITS, 2 ** (2 * AXIS_BITS)):
        for beside in (cells[best] - apart, cells[best] + apart):
            at = np.minimum(np.searchsorted(cells, beside), len(cells) - 1)
            total += np.where(cells[at] == beside, np.float32(NEIGHBOUR) * counts[at], 0)
    views = cells[best] >> MOTION_BITS
    first = np.flatnonzero(np.diff(views, prepend=-1))
    if len(first) == 0:
        return np.empty(0, np.intp), np.empty(0, np.float32)
    most = np.maximum.reduceat(total, first)
    order = np.argsort(-most, kind="stable")[:n]
    return views[first][order], most[order]


def phases(bofs: PlacedBofs) -> NDArray[np.uint8]:
    """Return the phases (C, 2) of the two harmonics, 256 to the circle."""
    half = N_HARMONICS
    codes = bofs.codes[:, :half] + 1j * bofs.codes[:, half:]
    circles = np.angle(codes[:, HARMONICS]) / (2 * np.pi)
    return np.rint(circles * 256).astype(np.int16).astype(np.uint8)
