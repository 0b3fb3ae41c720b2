"""The figures of a comparison of scene labelling methods, drawn by plotly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from slam_bof.evaluation import Roc
from slam_bof.types import Array
from slam_bof.visualization.figure_style import COLORS, PALETTE, apply_style

__all__ = ["draw_confusion", "draw_reliability", "draw_roc"]

Figure = Any


def draw_confusion(counts: NDArray[np.integer], classes: Sequence[str]) -> Figure:
    """Draw a confusion matrix (C, C) of frames: true classes as rows, predicted as columns."""
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    names = list(classes)
    figure = go.Figure(
        go.Heatmap(
            z=shares.round(4).tolist(),
            x=names,
            y=names,
            text=counts.tolist(),
            texttemplate="%{text}",
            colorscale=[[0.0, "white"], [1.0, COLORS["optimized"]]],
            zmin=0.0,
            zmax=1.0,
            showscale=False,
            hovertemplate="%{y} predicted as %{x}: %{text}<extra></extra>",
        )
    )
    figure.update_yaxes(autorange="reversed", title="true")
    figure.update_xaxes(title="predicted")
    return apply_style(figure).update_layout(height=180 + 34 * len(names))


def draw_roc(curves: Sequence[Roc]) -> Figure:
    """Draw the ROC curve of each class (Figure 9 of the paper), with the area in the legend."""
    figure = go.Figure()
    for number, curve in enumerate(curves):
        figure.add_scatter(
            x=curve.false_positive.round(4).tolist(),
            y=curve.true_positive.round(4).tolist(),
            name=f"{curve.label}: {curve.auc:.3f}",
            mode="lines",
            line={"color": PALETTE[number % len(PALETTE)]},
        )
    chance = {"color": COLORS["muted"], "dash": "dot"}
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line=chance, showlegend=False)
    figure.update_xaxes(title="false positive rate", range=[0, 1])
    figure.update_yaxes(title="true positive rate", range=[0, 1.02])
    return apply_style(figure).update_layout(height=520)


def draw_reliability(bins: Mapping[str, tuple[Array, Array, NDArray[np.intp]]]) -> Figure:
    """Draw the accuracy of labels over their mean probability, by method and bin."""
    figure = go.Figure()
    for number, (name, (means, shares, counts)) in enumerate(bins.items()):
        figure.add_scatter(
            x=means.round(4).tolist(),
            y=shares.round(4).tolist(),
            text=counts.tolist(),
            name=name,
            mode="lines+markers",
            visible=True if number < 2 else "legendonly",
            line={"color": PALETTE[number % len(PALETTE)]},
            hovertemplate="%{text} labels: %{y:.2f} correct at %{x:.2f}<extra></extra>",
        )
    chance = {"color": COLORS["muted"], "dash": "dot"}
    figure.add_scatter(x=[0, 1], y=[0, 1], mode="lines", line=chance, showlegend=False)
    figure.update_xaxes(title="predicted probability", range=[0, 1])
    figure.update_yaxes(title="share of correct labels", range=[0, 1.02])
    return apply_style(figure).update_layout(height=420)
