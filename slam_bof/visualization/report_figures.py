"""Figures of a run's report: loop candidates, labels, tracking and time, drawn by plotly."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from slam_bof.types import Array, Candidate, Scene
from slam_bof.visualization.figure_style import COLORS, Figure, apply_style, new_figure

__all__ = [
    "draw_candidates",
    "draw_health",
    "draw_labels",
    "draw_reasons",
    "draw_stages",
    "draw_uncertainty",
]


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
    figure = new_figure("time (s)", "")
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
    figure = new_figure("time (s)", "open directions")
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


def draw_uncertainty(times_s: Array, sigma_m: Array, sigma_rad: Array) -> Figure:
    """Draw the standard deviations of position and direction of each frame; NaN is a gap."""
    figure = new_figure("time (s)", "standard deviation")
    for name, sigma, color in (
        ("position (m)", sigma_m, COLORS["odometry"]),
        ("direction (degrees)", np.degrees(sigma_rad), COLORS["optimized"]),
    ):
        figure.add_scatter(
            x=times_s, y=sigma, mode="lines", name=name, line={"color": color, "width": 1.5}
        )
    figure.update_yaxes(type="log", dtick=1)
    return figure.update_layout(height=240)


def draw_stages(stage_ms: Mapping[str, float]) -> Figure:
    """Draw the mean time of each stage, in milliseconds per frame."""
    figure = new_figure("wall time per frame (ms)", "")
    return _add_bars(
        figure, stage_ms, COLORS["optimized"], label="%{x:.1f} ms", hover="%{x:.2f} ms"
    )


def draw_reasons(counts: Mapping[str, int]) -> Figure:
    """Draw how many candidates were not accepted for each reason."""
    figure = _add_bars(
        new_figure("pairs", ""), counts, COLORS["odometry"], label="%{x}", hover="%{x}"
    )
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
