"""Loops as a matrix of frames, as the paper's Figure 10 has them, drawn by OpenCV."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.figures import COLORS

__all__ = ["draw_loop_matrix", "write_png"]

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
    """Draw pairs of frames: the newer one counts downwards, the older one to the right.

    Parameters
    ----------
    scores
        (K, K) similarity of row and column, darker the more alike; 0 where not compared.
    truth
        (K, K), pairs that show the same place by ground truth: tinted.
    loops
        By what the legend calls them, a colour (name of ``figures.COLORS``) and the pairs
        (L, 2) of query and match to mark.
    title
        Stands above.

    Returns
    -------
    Image
        (H, W, 3) uint8, blue first, as OpenCV has it.

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


def write_png(path: Path, image: Image) -> None:
    """Write a picture; OSError where it cannot be written."""
    _, coded = cv2.imencode(".png", image)
    path.write_bytes(coded.tobytes())


def _background(scores: NDArray[np.floating], truth: NDArray[np.bool_]) -> Image:
    """Return the scores in grey, the best hundredth black, over the tinted truth."""
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


def _write(image: Image, text: str, at: tuple[int, int], size: float) -> None:
    color = _bgr(COLORS["text"])
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)
