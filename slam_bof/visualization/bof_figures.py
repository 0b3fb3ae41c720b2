"""Pictures of the method: the layers and BOFs of a frame, and the constellations of two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import (
    Constellation,
    ConstellationMatch,
    PlaceParams,
    describe,
    find_contours,
    layer_images,
)
from slam_bof.geometry import points_camera_f32, se3
from slam_bof.types import Array, DepthFrame
from slam_bof.visualization.figure_style import COLORS
from slam_bof.visualization.svg import document, dots, line, picture, shape, words

__all__ = ["draw_bof", "draw_constellations"]

MARGIN_PX, TITLE_PX, PANEL_PX = 16, 28, 300
MAX_POINTS = 2000
"""Points of the cloud that are drawn."""
COARSE_PX = 60
"""Pixels along a side of a layer's image as it is drawn."""
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
QUERY, MATCH = COLORS["odometry"], COLORS["optimized"]


def draw_bof(frame: DepthFrame, params: PlaceParams, *, title: str) -> str:
    """Draw the cloud of a frame, its layers with their contours, and the BOFs of these.

    It is the paper's Figure 2: a colour for each layer.

    Returns
    -------
    str
        The picture as SVG.
    """
    points = points_camera_f32(frame, params.points)
    images = layer_images(points, params.layers)
    contours = find_contours(images, params.contours)
    radii = describe(contours, params.bof)
    n = len(images)
    colors = [_color(k / max(n - 1, 1)) for k in range(n)]
    left = [MARGIN_PX + k * (PANEL_PX + MARGIN_PX) for k in range(3)]
    top = MARGIN_PX + 2 * TITLE_PX
    parts = [
        words(MARGIN_PX, MARGIN_PX + 14, title, size=15),
        words(left[0], top - 10, f"Cloud of {len(points)} points in {n} layers"),
        words(left[1], top - 10, "Their binary images with contours"),
        words(left[2], top - 10, f"BOF: {len(radii)} curves of {radii.shape[1]} values"),
        *_cloud(points, n, colors, (left[0], top)),
    ]
    n_columns = int(np.ceil(np.sqrt(n)))
    side = PANEL_PX / n_columns
    scale = (side - 4) / params.layers.resolution_px
    block = max(1, -(-params.layers.resolution_px // COARSE_PX))
    for k, image in enumerate(images):
        x, y = left[1] + k % n_columns * side, top + k // n_columns * side
        parts.append(shape(SQUARE * (side - 4) + (x, y), COLORS["grid"]))
        parts.append(picture(_coarse(image, block), x, y, block * scale, COLORS["muted"]))
        for points_px in (contours.points_px[i] for i in np.flatnonzero(contours.layer == k)):
            outline = scale * (points_px.astype(np.float64) + 0.5) + (x, y)
            parts.append(shape(outline, colors[k], fill=colors[k], width=1.2))
    values = np.linspace(left[2], left[2] + PANEL_PX, radii.shape[1])[::3]
    parts += [
        line(np.stack([values, top + PANEL_PX * (1 - curve)], axis=1), colors[k], opacity=0.7)
        for curve, k in zip(radii[:, ::3], contours.layer, strict=True)
    ]
    parts.append(shape(SQUARE * PANEL_PX + (left[2], top), COLORS["grid"]))
    return document(left[2] + PANEL_PX + MARGIN_PX, top + PANEL_PX + MARGIN_PX, parts)


def draw_constellations(
    query: Constellation,
    match: Constellation,
    hypothesis: ConstellationMatch | None,
    *,
    title: str,
    names: tuple[str, str],
) -> str:
    """Draw the contours of two views in plan, those that correspond, and one on the other.

    Parameters
    ----------
    query, match
        The constellations.
    hypothesis
        The motion between the two, None where there is none.
    title, names
        The title, and what the two views are called.

    Returns
    -------
    str
        The picture as SVG.
    """
    views = [_outlines(query), _outlines(match)]
    pairs = np.empty((0, 2), np.intp) if hypothesis is None else hypothesis.inliers
    headings = [f"{name}: {len(view)} contours" for name, view in zip(names, views, strict=True)]
    headings.append("No contours correspond")
    if hypothesis is not None:
        T = hypothesis.T_match_query
        moved_m, turned_deg = np.linalg.norm(T[:3, 3]), np.degrees(se3.rotation_angle(T))
        headings[-1] = f"{len(pairs)} pairs agree: {moved_m:.2f} m, {turned_deg:.0f} degrees apart"
        views.append(_move(views[0], query, match, T))
    plan = _Plan.of(views)
    parts = [words(MARGIN_PX, MARGIN_PX + 14, title, size=15)]
    for panel, heading in enumerate(headings):
        parts.append(words(plan.left(panel), plan.top - 10, heading))
        parts.append(_camera(plan.place(np.zeros(1, complex), panel)[0]))
    parts += _draw_pairs(query, match, views[:2], pairs, plan)
    for column, color, view, name in (
        (1, MATCH, views[1], names[1]),
        (0, QUERY, views[-1], names[0]),
    ):
        chosen = np.unique(pairs[:, column])
        parts += [shape(plan.place(view[k], 2), color) for k in chosen]
        if len(chosen):
            x = plan.left(2) + 150 * (1 - column)
            parts.append(words(x, plan.top + PANEL_PX, name, color=color))
    return document(plan.left(3), plan.top + PANEL_PX + MARGIN_PX, parts)


class _Plan(NamedTuple):
    """Panels side by side that show points ``x + i z`` in plan, all at one scale."""

    low: Array
    scale: float
    top: float = MARGIN_PX + 2 * TITLE_PX

    @classmethod
    def of(cls, views: Sequence[NDArray[np.complex128]]) -> _Plan:
        """Choose the scale at which all outlines and the camera fit into a panel."""
        corners = np.concatenate([[0j], *(view.reshape(-1) for view in views)])
        low = np.array([corners.real.min(), corners.imag.min() - 0.3])
        return cls(low, PANEL_PX / max(np.ptp(corners.real), np.ptp(corners.imag) + 0.3))

    def left(self, panel: int) -> float:
        """Return the left edge of a panel."""
        return MARGIN_PX + panel * (PANEL_PX + MARGIN_PX)

    def place(self, points: NDArray[np.complex128], panel: int) -> Array:
        """Return where points (...,) are in the picture, (..., 2)."""
        x, z = (points.real - self.low[0]) * self.scale, (points.imag - self.low[1]) * self.scale
        return np.stack([self.left(panel) + x, self.top + PANEL_PX - z], axis=-1)


def _draw_pairs(
    query: Constellation,
    match: Constellation,
    views: Sequence[NDArray[np.complex128]],
    pairs: NDArray[np.intp],
    plan: _Plan,
) -> list[str]:
    """Draw the contours of both views, and lines between those that correspond, by height."""
    parts = []
    slices = match.bofs.slices[pairs[:, 1]].astype(float)
    shares = (slices - slices.min(initial=99)) / max(np.ptp(slices) if len(slices) else 0, 1)
    for panel, view in enumerate(views):
        colors = {k: _color(share) for k, share in zip(pairs[:, panel], shares, strict=True)}
        for k in sorted(range(len(view)), key=colors.__contains__):
            width, color = (1.4, colors[k]) if k in colors else (0.6, COLORS["muted"])
            parts.append(shape(plan.place(view[k], panel), color, width=width))
    for (a, b), share in zip(pairs, shares, strict=True):
        ends = query.bofs.centroids_m[a], match.bofs.centroids_m[b]
        both = np.stack([plan.place(np.array(end), panel) for panel, end in enumerate(ends)])
        parts.append(line(both, _color(share), width=0.6, opacity=0.5))
    return parts


def _cloud(
    points: NDArray[np.float32], n_layers: int, colors: list[str], corner: tuple[float, float]
) -> list[str]:
    """Draw points from above and the right, so that layers along the optical axis are seen."""
    points = points[:: max(1, len(points) // MAX_POINTS)]
    if len(points) == 0:
        return []
    x, y, z = points.T
    oblique = np.stack([x + 0.6 * z, y - 0.3 * z], axis=1)
    low, extent = oblique.min(axis=0), max(np.ptp(oblique, axis=0).max(), 1e-6)
    at = (oblique - low) * (PANEL_PX / extent) + corner
    layer = np.minimum((z - z.min()) / max(np.ptp(z), 1e-6) * n_layers, n_layers - 1).astype(int)
    return [dots(at[layer == k], color) for k, color in enumerate(colors) if (layer == k).any()]


def _coarse(image: NDArray[np.uint8], block: int) -> NDArray[np.bool_]:
    """Return where a block of pixels holds one that is set."""
    missing = -np.array(image.shape) % block
    padded = np.pad(image, ((0, missing[0]), (0, missing[1])))
    rows, columns = np.array(padded.shape) // block
    return np.asarray(padded.reshape(rows, block, columns, block).any(axis=(1, 3)))


def _outlines(view: Constellation, n: int = 60) -> NDArray[np.complex128]:
    """Return the contours (C, n) as ``x + i z`` in metres, as far as their BOFs know them."""
    rays = np.exp(2j * np.pi * np.arange(n) / n)
    return np.asarray(view.bofs.centroids_m[:, None] + view.bofs.radii(n) * rays)


def _move(
    outlines: NDArray[np.complex128], query: Constellation, match: Constellation, T: Array
) -> NDArray[np.complex128]:
    """Move outlines of the query's levelled frame to the match's."""
    R = match.R_level_camera @ T[:3, :3] @ query.R_level_camera.T
    t = match.R_level_camera @ T[:3, 3]
    x, z = outlines.real, outlines.imag
    return np.asarray(R[0, 0] * x + R[0, 2] * z + t[0] + 1j * (R[2, 0] * x + R[2, 2] * z + t[2]))


def _camera(at: Array) -> str:
    return shape(np.array([[0, 0], [-6, -12], [6, -12]]) + at, COLORS["text"])


def _color(share: float) -> str:
    return f"hsl({265 - 230 * share:.0f} 65% 42%)"
