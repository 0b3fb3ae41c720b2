"""The figures of a run's report, drawn by plotly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from slam_bof.types import Array, Candidate, Scene

__all__ = [
    "COLORS",
    "PALETTE",
    "apply_style",
    "draw_candidates",
    "draw_errors",
    "draw_health",
    "draw_labels",
    "draw_reasons",
    "draw_stages",
    "draw_top_view",
    "draw_trajectories",
]

Figure = Any

COLORS = {
    "groundtruth": "#23282f",
    "odometry": "#d08a4e",
    "optimized": "#2f6db5",
    "good": "#3a9a6a",
    "bad": "#c8423f",
    "muted": "#b9c0ca",
    "text": "#23282f",
    "grid": "#e8ebef",
}
PALETTE = ("#2f6fd6", "#d9822b", "#3a9a6a", "#c8423f", "#7a5cc0", "#8a6d4b", "#4aa3b8", "#6b7280")
NAMES = {"groundtruth": "ground truth", "odometry": "odometry alone", "optimized": "with loops"}
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
HEIGHT_PX = 460
MAX_LINKS = 80
"""Number of edges of one kind that are drawn in a figure."""


def draw_top_view(
    paths: Mapping[str, Array], links: Mapping[str, Array], keyframes: Array
) -> Figure:
    """Draw paths from above.

    Parameters
    ----------
    paths
        (N, 3) positions right, forward, up in metres, by ``groundtruth``, ``odometry`` and
        ``optimized``.
    links
        (L, 2, 3) end points of edges by ``loop``, ``wrong`` and ``covisibility``.
    keyframes
        (K, 3) positions.
    """
    figure = _figure("right (m)", "forward (m)")
    figure.update_yaxes(scaleanchor="x", scaleratio=1)
    for name, points in paths.items():
        figure.add_scatter(x=points[:, 0], y=points[:, 1], **_path_style(name))
    figure.add_scatter(
        x=keyframes[:, 0],
        y=keyframes[:, 1],
        customdata=np.arange(len(keyframes)),
        mode="markers",
        name="keyframes",
        marker={"size": 5, "color": COLORS["optimized"]},
        hovertemplate="keyframe %{customdata}<extra></extra>",
    )
    for name, ends in links.items():
        drawn = _thinned(name, ends)
        x, y, _ = _segments(drawn)
        figure.add_scatter(x=x, y=y, **_link_style(name, len(drawn), len(ends)))
    if len(points := paths["optimized"]):
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
    figure = _figure("", "")
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
    figure = _figure("time (s)", "position error (m)")
    for name, values in errors_m.items():
        figure.add_scatter(x=times_s, y=values, **_path_style(name))
    return figure.update_yaxes(rangemode="tozero").update_layout(hovermode="x unified", height=320)


def draw_candidates(candidates: Sequence[Candidate], times_s: Array) -> Figure:
    """Draw score and overlap of each candidate.

    ``times_s[i]`` is the time of ``candidates[i].query_id``.
    """
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    apply_style(figure)
    decisions = {
        "rejected": {"color": COLORS["muted"], "size": 5},
        "accepted": {"color": COLORS["good"], "size": 7},
    }
    for decision, marker in decisions.items():
        chosen = [
            (c, t) for c, t in zip(candidates, times_s, strict=True) if c.decision == decision
        ]
        scores = [c.score if np.isnan(c.eta) else c.eta for c, _ in chosen]
        overlap = [c.overlap for c, _ in chosen]
        for row, values in enumerate((scores, overlap), start=1):
            figure.add_scatter(
                x=[t for _, t in chosen],
                # JSON has no infinity; plotly does not draw None.
                y=[float(v) if np.isfinite(v) else None for v in values],
                text=[_describe(c) for c, _ in chosen],
                mode="markers",
                name=decision,
                legendgroup=decision,
                showlegend=row == 1,
                marker=marker,
                hovertemplate="%{text}<extra></extra>",
                row=row,
                col=1,
            )
    figure.update_xaxes(title_text="time of the query keyframe (s)", row=2, col=1)
    figure.update_yaxes(title_text="score (η for bags)", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="overlap of the clouds", rangemode="tozero", row=2, col=1)
    return figure.update_layout(height=520)


def draw_labels(
    times_s: Array, scenes: Sequence[Scene | None], true_labels: Sequence[str | None] | None
) -> Figure:
    """Draw the predicted label of each keyframe, and the true label where it is known."""
    figure = _figure("time (s)", "")
    true = list(true_labels) if true_labels is not None else [None] * len(scenes)
    known = [(t, label) for t, label in zip(times_s, true, strict=True) if label is not None]
    if known:
        figure.add_scatter(
            x=[t for t, _ in known],
            y=[label for _, label in known],
            mode="markers",
            name="true",
            marker={"symbol": "square", "size": 16, "color": COLORS["grid"]},
            hovertemplate="true: %{y}<extra></extra>",
        )
    groups: dict[str, tuple[str, list[tuple[float, Scene]]]] = {
        "predicted, correct": (COLORS["good"], []),
        "predicted, wrong": (COLORS["bad"], []),
        "predicted": (COLORS["optimized"], []),
    }
    for t, scene, label in zip(times_s, scenes, true, strict=True):
        if scene is not None:
            verdict = "correct" if scene.label == label else "wrong"
            name = "predicted" if label is None else f"predicted, {verdict}"
            groups[name][1].append((float(t), scene))
    for name, (color, points) in groups.items():
        if points:
            figure.add_scatter(
                x=[t for t, _ in points],
                y=[scene.label for _, scene in points],
                text=[f"{scene.label}, probability {scene.probability:.2f}" for _, scene in points],
                mode="markers",
                name=name,
                marker={
                    "color": color,
                    "size": [4.0 + 6.0 * float(scene.probability) for _, scene in points],
                },
                hovertemplate="%{x:.1f} s: %{text}<extra></extra>",
            )
    labels = {s.label for s in scenes if s is not None} | {label for _, label in known}
    figure.update_yaxes(
        type="category", categoryorder="array", categoryarray=sorted(labels, reverse=True)
    )
    return figure.update_layout(height=140 + 44 * max(2, len(labels)))


def draw_health(times_s: Array, n_open: Array, is_lost: NDArray[np.bool_]) -> Figure:
    """Draw the number of directions that the surfaces in sight leave open, and lost frames."""
    figure = _figure("time (s)", "open directions")
    figure.add_scatter(
        x=times_s,
        y=np.where(is_lost, np.nan, n_open),
        mode="lines",
        name="of 6, by frame",
        line={"color": COLORS["odometry"], "width": 1.5, "shape": "hv"},
    )
    figure.add_scatter(
        x=times_s[is_lost],
        y=np.zeros(int(is_lost.sum())),
        mode="markers",
        name=f"lost ({int(is_lost.sum())})",
        marker={"color": COLORS["bad"], "size": 6, "symbol": "square"},
    )
    figure.update_yaxes(range=[-0.2, 6.2], dtick=1)
    return figure.update_layout(height=240)


def draw_stages(stage_ms: Mapping[str, float]) -> Figure:
    """Draw the mean time of each stage, in milliseconds per frame."""
    figure = _figure("wall time per frame (ms)", "")
    return _add_bars(
        figure, stage_ms, COLORS["optimized"], label="%{x:.1f} ms", hover="%{x:.2f} ms"
    )


def draw_reasons(counts: Mapping[str, int]) -> Figure:
    """Draw how many candidates were not accepted for each reason."""
    figure = _add_bars(_figure("pairs", ""), counts, COLORS["odometry"], label="%{x}", hover="%{x}")
    return figure.update_yaxes(automargin=True)


def _add_bars(
    figure: Figure, values: Mapping[str, float], color: str, *, label: str, hover: str
) -> Figure:
    """Add a horizontal bar for each value; ``label`` and ``hover`` are templates of its number."""
    figure.add_bar(
        x=list(values.values()),
        y=list(values),
        orientation="h",
        marker={"color": color},
        texttemplate=label,
        textposition="outside",
        cliponaxis=False,
        hovertemplate=f"%{{y}}: {hover}<extra></extra>",
    )
    figure.update_yaxes(autorange="reversed")
    return figure.update_layout(height=80 + 34 * len(values), bargap=0.35, margin={"t": 16})


def draw_precision_recall(curves: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Draw precision over recall.

    ``curves`` has (N, 2) recall and precision by kind of ground truth, side by side, and then by
    name of the method.
    """
    figure = make_subplots(
        1, len(curves), subplot_titles=[f"truth by {kind}" for kind in curves], shared_yaxes=True
    )
    names = sorted({name for by_name in curves.values() for name in by_name})
    for column, by_name in enumerate(curves.values(), start=1):
        for name, points in by_name.items():
            figure.add_scatter(
                x=points[:, 0],
                y=points[:, 1],
                name=name,
                legendgroup=name,
                showlegend=column == 1,
                line={"color": PALETTE[names.index(name) % len(PALETTE)]},
                row=1,
                col=column,
            )
    figure.update_xaxes(title="recall", range=[0, 1])
    figure.update_yaxes(title="precision", range=[0, 1.03])
    return apply_style(figure)


def _figure(x_title: str, y_title: str) -> Figure:
    figure = apply_style(go.Figure())
    return figure.update_layout(
        xaxis_title={"text": x_title}, yaxis_title={"text": y_title}, height=HEIGHT_PX
    )


def apply_style(figure: Figure) -> Figure:
    """Apply the common style to a figure."""
    axis: dict[str, Any] = {"gridcolor": COLORS["grid"], "zeroline": False}
    axis |= {"linecolor": COLORS["muted"]}
    axis["title"] = {"font": {"size": 13}}
    figure.update_xaxes(**axis, ticks="outside", tickcolor=COLORS["muted"])
    figure.update_yaxes(**axis, automargin=True)
    return figure.update_layout(
        template="none",
        font={"family": FONT, "size": 13, "color": COLORS["text"]},
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        margin={"l": 64, "r": 24, "t": 56, "b": 56},
        paper_bgcolor="white",
        plot_bgcolor="white",
        hoverlabel={"font": {"family": FONT}},
    )


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


def _describe(candidate: Candidate) -> str:
    """Return the hover text of a candidate."""
    measured = {
        "score": candidate.score,
        "η": candidate.eta,
        "overlap": candidate.overlap,
        "RMSE (m)": candidate.rmse_m,
    }
    return "<br>".join(_lines(candidate, measured))


def _lines(candidate: Candidate, measured: Mapping[str, float]) -> Iterable[str]:
    yield f"keyframe {candidate.query_id} with {candidate.match_id}, by {candidate.source}"
    yield ", ".join(f"{name} {v:.3f}" for name, v in measured.items() if np.isfinite(v))
    yield f"{candidate.decision}: {candidate.reason}"
