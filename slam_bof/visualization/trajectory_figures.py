"""Figures of trajectories and their errors, drawn by plotly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from slam_bof.types import Array
from slam_bof.visualization.figure_style import COLORS, PALETTE, Figure, new_figure

__all__ = ["draw_errors", "draw_top_view", "draw_trajectories"]

NAMES = {"groundtruth": "ground truth", "odometry": "odometry alone", "optimized": "with loops"}
MAX_LINKS = 80
"""Number of edges of one kind that are drawn in a figure."""
COMPONENT_COLORS = PALETTE[4:]
"""Of further components: those unlike odometry, the largest component, loops and wrong loops."""


def draw_top_view(
    paths: Mapping[str, Array],
    links: Mapping[str, Array],
    keyframes: Array,
    texts: Sequence[str],
) -> Figure:
    """Draw paths from above.

    Parameters
    ----------
    paths
        (N, 3) positions right, forward, up in metres, by ``groundtruth``, ``odometry``,
        ``optimized`` and the names of further components.
    links
        (L, 2, 3) end points of edges by ``loop``, ``wrong`` and ``covisibility``.
    keyframes
        (K, 3) positions.
    texts
        What is shown over each keyframe.
    """
    figure = new_figure("right (m)", "forward (m)")
    figure.update_yaxes(scaleanchor="x", scaleratio=1)
    for name, points in paths.items():
        figure.add_scatter(x=points[:, 0], y=points[:, 1], **_path_style(name))
    figure.add_scatter(
        x=keyframes[:, 0],
        y=keyframes[:, 1],
        text=list(texts),
        mode="markers",
        name="keyframes",
        marker={"size": 5, "color": COLORS["optimized"]},
        hovertemplate="%{text}<extra></extra>",
    )
    for name, ends in links.items():
        drawn = _thinned(name, ends)
        x, y, _ = _segments(drawn)
        figure.add_scatter(x=x, y=y, **_link_style(name, len(drawn), len(ends)))
    points = paths["optimized"]
    points = points[np.isfinite(points).all(axis=1)]
    if len(points):
        for label, side, (x, y, _) in (
            ("start", "top right", points[0]),
            ("end", "bottom right", points[-1]),
        ):
            figure.add_scatter(
                x=[x],
                y=[y],
                text=[label],
                mode="markers+text",
                textposition=side,
                marker={"symbol": "circle-open", "size": 11, "color": COLORS["text"]},
                showlegend=False,
                hoverinfo="text",
            )
    return figure


def draw_trajectories(paths: Mapping[str, Array], links: Mapping[str, Array]) -> Figure:
    """Draw paths in 3D; parameters and colours are those of ``draw_top_view``."""
    figure = new_figure("", "")
    for name, points in paths.items():
        x, y, z = points.T
        figure.add_scatter3d(x=x, y=y, z=z, **_path_style(name))
    for name in ("loop", "wrong"):
        if name in links:
            drawn = _thinned(name, links[name])
            x, y, z = _segments(drawn)
            figure.add_scatter3d(x=x, y=y, z=z, **_link_style(name, len(drawn), len(links[name])))
    axis = {
        "showbackground": False,
        "gridcolor": COLORS["grid"],
        "zerolinecolor": COLORS["grid"],
        "showspikes": False,
        "nticks": 6,
    }
    # All axes have the same scale, and the longest fits into the view.
    low, high = _bounds(paths.values())
    x, y, z = ((high - low) / (high - low).max()).tolist()
    ranges = np.stack([low, high], axis=1).tolist()
    figure.update_scenes(
        aspectmode="manual",
        aspectratio={"x": x, "y": y, "z": z},
        xaxis={**axis, "range": ranges[0], "title": {"text": "right (m)", "font": {"size": 12}}},
        yaxis={**axis, "range": ranges[1], "title": {"text": "forward (m)", "font": {"size": 12}}},
        zaxis={
            **axis,
            "nticks": 3,
            "range": ranges[2],
            "title": {"text": "up (m)", "font": {"size": 12}},
        },
        camera={"eye": {"x": -0.7, "y": -1.3, "z": 0.85}, "center": {"x": 0, "y": 0, "z": -0.1}},
    )
    return figure.update_layout(showlegend=False, margin={"l": 0, "r": 0, "t": 0, "b": 0})


def draw_errors(times_s: Array, errors_m: Mapping[str, Array]) -> Figure:
    """Draw position errors (N,) over time, by ``odometry`` and ``optimized``."""
    figure = new_figure("time (s)", "position error (m)")
    for name, values in errors_m.items():
        figure.add_scatter(x=times_s, y=values, **_path_style(name))
    return figure.update_yaxes(rangemode="tozero").update_layout(hovermode="x unified", height=320)


def _bounds(paths: Iterable[Array]) -> tuple[Array, Array]:
    """Return the corners (3,) of a box around the points (N, 3), with a margin on every side."""
    points = np.concatenate(list(paths))
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return np.full(3, -1.0), np.full(3, 1.0)
    center = (points.max(axis=0) + points.min(axis=0)) / 2.0
    half = 0.55 * np.ptp(points, axis=0)
    half = half.clip(max(0.1 * half.max(), 0.05))
    return center - half, center + half


def _path_style(name: str) -> dict[str, Any]:
    lines: dict[str, dict[str, Any]] = {
        "groundtruth": {"width": 1.5, "dash": "dot"},
        "odometry": {"width": 2},
        "optimized": {"width": 3},
    }
    if name not in NAMES:  # a further component
        color = COMPONENT_COLORS[(int(name.split()[-1]) - 1) % len(COMPONENT_COLORS)]
        return {"mode": "lines", "name": name, "line": {"color": color, "width": 3}}
    return {
        "mode": "lines",
        "name": NAMES[name],
        "line": {"color": COLORS[name], **lines[name]},
    }


def _thinned(name: str, ends: Array) -> Array:
    """Return as many edges (L, 2, 3) as can be told apart, evenly chosen; all that are wrong."""
    return ends if name == "wrong" else ends[:: -(-len(ends) // MAX_LINKS) or 1]


def _link_style(name: str, n_drawn: int, n: int) -> dict[str, Any]:
    color = {"loop": "good", "wrong": "bad", "covisibility": "muted"}[name]
    words = {"loop": "loops", "wrong": "wrong loops", "covisibility": "covisibility edges"}[name]
    return {
        "mode": "lines",
        "name": f"{words} ({n})" if n_drawn == n else f"{words} ({n_drawn} of {n} drawn)",
        "line": {"color": COLORS[color], "width": 2 if name == "loop" else 3},
        "visible": "legendonly" if name == "covisibility" else True,
        "hoverinfo": "name",
    }


def _segments(ends: Array) -> tuple[list[Any], list[Any], list[Any]]:
    """Return x, y and z of (L, 2, 3) line segments, with None after each."""
    axes: tuple[list[Any], list[Any], list[Any]] = ([], [], [])
    for a, b in ends.tolist():
        for axis, start, end in zip(axes, a, b, strict=True):
            axis.extend((start, end, None))
    return axes
