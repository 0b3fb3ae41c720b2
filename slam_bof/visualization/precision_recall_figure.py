"""The figure of precision over recall, drawn by plotly."""

from __future__ import annotations

from collections.abc import Mapping

from plotly.subplots import make_subplots

from slam_bof.types import Array
from slam_bof.visualization.figure_style import PALETTE, Figure, apply_style

__all__ = ["draw_precision_recall"]


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
