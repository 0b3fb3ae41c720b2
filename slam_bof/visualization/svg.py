"""Parts of an SVG picture as text."""

from __future__ import annotations

from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from slam_bof.types import Array
from slam_bof.visualization.figure_style import COLORS, FONT

__all__ = ["document", "dots", "line", "picture", "shape", "words"]


def document(width_px: float, height_px: float, parts: list[str]) -> str:
    """Return a picture on white."""
    size = f"{width_px:.0f} {height_px:.0f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" font-family="{FONT}">\n'
        f'<rect width="100%" height="100%" fill="#fff"/>\n{"".join(parts)}</svg>\n'
    )


def words(x: float, y: float, text: str, *, size: float = 13, color: str = COLORS["text"]) -> str:
    """Return a line of text, beginning at a point on its base line."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" fill="{color}">{escape(text)}</text>\n'
    )


def line(points_px: Array, color: str, *, width: float = 1.0, opacity: float = 1.0) -> str:
    """Return a line through points (N, 2)."""
    return _path("M" + _corners(points_px), f'fill="none" stroke="{color}"', width, opacity)


def shape(
    points_px: Array, color: str, *, fill: str = "none", width: float = 1.0, opacity: float = 1.0
) -> str:
    """Return a closed polygon of points (N, 2)."""
    style = f'fill="{fill}" fill-opacity="0.25" stroke="{color}"'
    return _path(f"M{_corners(points_px)}Z", style, width, opacity)


def dots(points_px: Array, color: str, *, width: float = 1.2) -> str:
    """Return points (N, 2) as dots."""
    each = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points_px)
    return _path(each or "M0 0", f'stroke-linecap="round" stroke="{color}"', width, 1.0)


def picture(mask: NDArray[np.bool_], x: float, y: float, pixel_px: float, color: str) -> str:
    """Return the pixels of a binary image that are set, with its corner at a point."""
    rows, columns = np.nonzero(mask)
    starts = np.flatnonzero((np.diff(rows, prepend=-1) != 0) | (np.diff(columns, prepend=-2) != 1))
    lengths = np.diff(starts, append=len(rows))
    runs = "".join(
        f"M{x + columns[k] * pixel_px:.1f} {y + (rows[k] + 0.5) * pixel_px:.1f}h{n * pixel_px:.1f}"
        for k, n in zip(starts, lengths, strict=True)
    )
    return _path(runs or "M0 0", f'stroke="{color}"', pixel_px, 1.0)


def _corners(points_px: Array) -> str:
    return "L".join(f"{x:.1f} {y:.1f}" for x, y in points_px)


def _path(d: str, style: str, width: float, opacity: float) -> str:
    faint = "" if opacity == 1.0 else f' opacity="{opacity:g}"'
    return f'<path d="{d}" {style} stroke-width="{width:g}"{faint}/>\n'
