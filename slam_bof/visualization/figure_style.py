"""The common style of all figures that plotly draws."""

from __future__ import annotations

from typing import Any

import plotly.graph_objects as go

__all__ = ["COLORS", "PALETTE", "Figure", "apply_style", "new_figure"]

Figure = Any
"""A figure of plotly, which has no types."""

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
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
HEIGHT_PX = 460


def new_figure(x_title: str, y_title: str) -> Figure:
    """Return an empty figure with titles of its axes."""
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
