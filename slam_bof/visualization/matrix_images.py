"""Matrices drawn as images: loops (Figure 10 of the paper) and confusion of scene labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.visualization.figure_style import COLORS

__all__ = ["draw_confusion", "draw_loop_matrix", "write_png"]

SIDE_PX = 720
MARGIN_PX = 56
LEGEND_PX = 24
TRUTH = "#cfe0f5"

Image = NDArray[np.uint8]


def draw_loop_matrix(
    scores: NDArray[np.floating],
    truth: NDArray[np.bool_],
    loops: Mapping[str, tuple[str, ArrayLike]],
    *,
    title: str,
) -> Image:
    """Draw pairs of frames, the newer one as row and the older one as column.

    Parameters
    ----------
    scores
        (K, K) similarity of row and column, drawn darker where higher; 0 where not compared.
    truth
        (K, K) whether a pair shows the same place by ground truth; such pairs are tinted.
    loops
        For each name in the legend, a colour (a key of ``figure_style.COLORS``) and the pairs
        (L, 2) of query and match to mark.
    title
        The line above the matrix.

    Returns
    -------
    Image
        (H, W, 3) uint8, in the order blue, green, red.

    Raises
    ------
    ValueError
        If the matrices are not square and of one size.
    """
    n = len(scores)
    if scores.shape != (n, n) or truth.shape != (n, n):
        raise ValueError(f"matrices must be (K, K), got {scores.shape} and {truth.shape}")
    side = SIDE_PX + 2 * MARGIN_PX
    image = np.full((side + LEGEND_PX * len(loops), side, 3), 255, np.uint8)
    inside = slice(MARGIN_PX, MARGIN_PX + SIDE_PX)
    image[inside, inside] = _background(scores, truth)
    corner = (MARGIN_PX - 1, MARGIN_PX - 1), (MARGIN_PX + SIDE_PX, MARGIN_PX + SIDE_PX)
    cv2.rectangle(image, *corner, _bgr(COLORS["muted"]))
    _write(image, title, (MARGIN_PX, MARGIN_PX - 30), 0.55)
    _write(image, "older frame", (MARGIN_PX, MARGIN_PX - 10), 0.42)
    _write(image, "0", (MARGIN_PX - 16, MARGIN_PX + 10), 0.42)
    _write(image, str(n - 1), (8, MARGIN_PX + SIDE_PX), 0.42)
    _write(image, "newer frame (down)", (MARGIN_PX, side - 34), 0.42)
    for row, (name, (color, pairs)) in enumerate(loops.items()):
        ids = np.asarray(pairs, dtype=np.intp).reshape(-1, 2)
        for query, match in ids.tolist():
            cv2.circle(image, (_at(match, n), _at(query, n)), 3, _bgr(COLORS[color]), -1)
        y = side - 12 + LEGEND_PX * row
        cv2.circle(image, (MARGIN_PX + 6, y), 5, _bgr(COLORS[color]), -1)
        _write(image, f"{name}: {len(ids)}", (MARGIN_PX + 20, y + 5), 0.45)
    return image


def draw_confusion(counts: NDArray[np.integer], classes: Sequence[str], *, title: str) -> Image:
    """Draw a confusion matrix: true classes as rows, predicted ones as columns.

    Parameters
    ----------
    counts
        (C, C) number of frames; colours are shares of the row.
    classes
        (C,) names of the classes.
    title
        The line above the matrix.

    Returns
    -------
    Image
        (H, W, 3) uint8, in the order blue, green, red.

    Raises
    ------
    ValueError
        If the counts are not (C, C).
    """
    n = len(classes)
    if counts.shape != (n, n):
        raise ValueError(f"counts must be ({n}, {n}) as the classes, got {counts.shape}")
    cell = max(34, min(96, SIDE_PX // max(n, 1)))
    names_px = 12 + 8 * max(map(len, classes), default=0)
    left, top = names_px, MARGIN_PX + 24
    image = np.full((top + cell * n + names_px, left + cell * n + MARGIN_PX, 3), 255, np.uint8)
    totals = counts.sum(axis=1, keepdims=True)
    shares = counts / np.maximum(totals, 1)
    deep = np.array(_bgr(COLORS["optimized"]), dtype=np.float64)
    _write(image, title, (8, 24), 0.55)
    _write(image, "true (rows), predicted (columns): frames", (8, 46), 0.42)
    for row in range(n):
        for column in range(n):
            x, y = left + cell * column, top + cell * row
            color = (255.0 + (deep - 255.0) * shares[row, column]).tolist()
            cv2.rectangle(image, (x, y), (x + cell - 2, y + cell - 2), color, -1)
            if counts[row, column]:
                dark = shares[row, column] > 0.5
                at = (x + 4, y + cell // 2 + 4)
                _write(image, str(counts[row, column]), at, 0.42, "#ffffff" if dark else None)
        _write(image, classes[row], (8, top + cell * row + cell // 2 + 4), 0.42)
    for column, name in enumerate(classes):
        _write_down(image, name, (left + cell * column + cell // 2 - 8, top + cell * n + 6))
    return image


def write_png(path: Path, image: Image) -> None:
    """Write an image as PNG; ``OSError`` if it cannot be written."""
    _, coded = cv2.imencode(".png", image)
    path.write_bytes(coded.tobytes())


def _background(scores: NDArray[np.floating], truth: NDArray[np.bool_]) -> Image:
    """Return the scores in grey, black for the best hundredth, over the tinted truth."""
    positive = scores[scores > 0.0]
    top = float(np.quantile(positive, 0.99)) if len(positive) else 1.0
    paper = np.where(truth[..., None], np.array(_bgr(TRUTH)), 255).astype(np.float32)
    ink = np.clip(scores / top, 0.0, 1.0)[..., None] ** 2
    pixels = (paper * (1.0 - 0.6 * ink)).astype(np.uint8)
    way = cv2.INTER_AREA if len(scores) > SIDE_PX else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(pixels, (SIDE_PX, SIDE_PX), interpolation=way), np.uint8)


def _at(index: int, n: int) -> int:
    return MARGIN_PX + int((index + 0.5) * SIDE_PX / n)


def _bgr(color: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return blue, green, red


def _write_down(image: Image, text: str, at: tuple[int, int]) -> None:
    """Write text from top to bottom."""
    x, y = at
    strip = np.full((16, 10 + 8 * len(text), 3), 255, np.uint8)
    _write(strip, text, (2, 12), 0.42)
    turned = cv2.rotate(strip, cv2.ROTATE_90_CLOCKWISE)[: image.shape[0] - y]
    image[y : y + len(turned), x : x + 16] = turned


def _write(
    image: Image, text: str, at: tuple[int, int], size: float, hex_color: str | None = None
) -> None:
    color = _bgr(hex_color or COLORS["text"])
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)
