"""Binary images of 32 pixels a word: closing, dilation, and outer contours.

All images of a view lie one below the other, with empty pixels between them. Their bits fit into
the caches of a processor, which their bytes do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled

__all__ = [
    "close",
    "dilate",
    "is_set",
    "n_words",
    "outer_contours",
    "pack_bits",
    "set_bit",
    "unpack_bits",
]

Words = NDArray[np.uint32]
"""(H, ceil(W / 32)); bit b of word k is column 32 k + b."""

ALL, NONE = np.uint32(0xFFFFFFFF), np.uint32(0)
ACROSS, DOWN = (1, 1, 0, -1, -1, -1, 0, 1), (0, -1, -1, -1, 0, 1, 1, 1)
"""Columns and rows from a pixel to its neighbours, counter-clockwise from the right."""


def n_words(width: int) -> int:
    """Return the number of words of a row."""
    return (width + 31) // 32


def pack_bits(images: NDArray[np.uint8]) -> Words:
    """Return images (..., W), nonzero where a pixel is set, as words."""
    missing = -images.shape[-1] % 32
    bits = np.pad(images != 0, [(0, 0)] * (images.ndim - 1) + [(0, missing)])
    return np.packbits(bits, axis=-1, bitorder="little").view(np.uint32)


def unpack_bits(words: Words, width: int) -> NDArray[np.uint8]:
    """Return words (..., K) as images (..., width), 0 or 1."""
    return np.unpackbits(words.view(np.uint8), axis=-1, count=width, bitorder="little")


@compiled
def _grow(words: Words, tall: Words, flip: np.uint32) -> None:
    """Set all pixels beside a set one; where ``flip`` is ``ALL``, clear all beside a clear one.

    The first and the last pixel of a row are empty, so that rows may be one long row.
    """
    width, n = words.shape[1], words.size
    flat, tall_ = words.reshape(n), tall.reshape(n)
    above, middle, below = flat[: n - 2 * width], flat[width : n - width], flat[2 * width :]
    inner = tall_[width : n - width]
    for i in range(len(inner)):
        inner[i] = (above[i] ^ flip) | (middle[i] ^ flip) | (below[i] ^ flip)
    left, right = tall_[width - 1 : n - width - 1], tall_[width + 1 : n - width + 1]
    for i in range(len(inner)):
        beside = (inner[i] << 1) | (inner[i] >> 1) | (left[i] >> 31) | (right[i] << 31)
        middle[i] = (inner[i] | beside) ^ flip


@compiled
def dilate(words: Words, radius_px: int) -> None:
    """Dilate by a square of ``2 radius_px + 1`` pixels; as many at the border must be empty."""
    tall = np.zeros_like(words)
    for _ in range(radius_px):
        _grow(words, tall, NONE)


@compiled
def close(words: Words, radius_px: int) -> None:
    """Close by a square; there must be more than ``radius_px`` empty pixels at the border."""
    tall = np.zeros_like(words)
    for _ in range(radius_px):
        _grow(words, tall, NONE)
    for _ in range(radius_px):
        _grow(words, tall, ALL)


@compiled
def is_set(words: Words, row: int, column: int) -> int:
    """Return 1 if a pixel is set, else 0."""
    return int(words[np.uint32(row), np.uint32(column >> 5)] >> (column & 31)) & 1


@compiled
def set_bit(words: Words, row: int, column: int) -> None:
    """Set a pixel."""
    words[np.uint32(row), np.uint32(column >> 5)] |= np.uint32(1 << (column & 31))


@compiled
def outer_contours(words: Words, min_area_px: float) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the corners (S, 2), x and y, of the outer contours, and how many each has (C,).

    Borders are followed as by Suzuki and Abe (1985), from the first pixel in order of rows; the
    lowest contour comes first. The area is that of the polygon through the centres of the pixels.
    The outermost pixels are cleared, so that each pixel has eight neighbours.
    """
    height, width = words.shape
    words[:1], words[-1:] = 0, 0
    words[:, 0] &= np.uint32(0xFFFFFFFE)
    words[:, -1] &= np.uint32(0x7FFFFFFF)
    border, right = np.zeros_like(words), np.zeros_like(words)
    corners = np.empty((1024, 2), np.int32)
    counts = np.empty(256, np.int64)
    n_corners = n_contours = 0
    for row in range(height):
        outside = True
        last = np.int64(0)
        for k in range(width):
            word = np.int64(words[row, k])
            starts = word & ~((word << 1) | last)
            last = word >> 31
            rest = 0xFFFFFFFF
            while True:
                # The leftmost start or border pixel that is still to be looked at.
                bits = (starts | border[row, k]) & rest
                if bits == 0:
                    break
                bit = bits & -bits
                rest = ~(2 * bit - 1)
                if outside and border[row, k] & bit == 0:
                    column = 32 * k
                    while bit >> (column & 31) != 1:
                        column += 1
                    n, area = _follow(words, border, right, row, column, corners[:0])
                    if area >= min_area_px:
                        if n_contours == len(counts):
                            counts = np.concatenate((counts, np.empty_like(counts)))
                        while n_corners + n > len(corners):
                            corners = np.concatenate((corners, np.empty_like(corners)))
                        _follow(words, border, right, row, column, corners[n_corners:])
                        counts[n_contours] = n
                        n_corners += n
                        n_contours += 1
                if border[row, k] & bit:
                    outside = right[row, k] & bit != 0
    found, first = np.empty((n_corners, 2), np.int32), n_corners
    begin = 0
    for n in counts[:n_contours][::-1]:
        first -= n
        found[begin : begin + n] = corners[first : first + n]
        begin += n
    return found, counts[:n_contours][::-1].copy()


@compiled
def _follow(
    words: Words, border: Words, right: Words, row: int, column: int, corners: NDArray[np.int32]
) -> tuple[int, float]:
    """Follow a border from its first pixel; return its number of corners and its area.

    Its pixels are noted in ``border``, and in ``right`` those that have the outside to their
    right. As many corners are written as there is room for.
    """
    first_row, first_column = row, column
    turn = 3  # The pixel to the left is clear.
    while turn != 4 and not is_set(words, row + DOWN[turn], column + ACROSS[turn]):
        turn = (turn - 1) & 7
    last, before = turn, -1
    n = double_area = 0
    while True:
        came = turn
        turn = (came + 1) & 7
        while turn != came and not is_set(words, row + DOWN[turn], column + ACROSS[turn]):
            turn = (turn + 1) & 7
        set_bit(border, row, column)
        if 0 < turn <= came:
            set_bit(right, row, column)
        if turn != before:
            if n < len(corners):
                corners[n] = column, row
            n += 1
            before = turn
        if last == 4:  # a single pixel
            return n, 0.0
        next_row, next_column = row + DOWN[turn], column + ACROSS[turn]
        double_area += column * next_row - next_column * row
        turn = (turn + 4) & 7  # where it came from
        if next_row == first_row and next_column == first_column and turn == last:
            return n, 0.5 * abs(double_area)
        row, column = next_row, next_column
