"""The plan of a map: what is free and occupied, the rooms by colour, and the path."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam_bof.geometry import se3
from slam_bof.types import Array
from slam_bof.visualization.figure_style import COLORS, PALETTE, apply_style
from slam_bof.visualization.plan import Plan

__all__ = ["draw_plan"]

FREE, OCCUPIED = 254, 0
"""Grey values of map_server, as the cells have them."""
ROOM_REACH_M = 3.0
"""A free cell belongs to the room of the nearest keyframe, if that is no farther than this."""
ROOM_SHARE = 0.35
"""Share of a room's colour in its cells; the rest is white."""


def draw_plan(plan: Plan) -> Any:
    """Draw the plan with the way from keyframe to keyframe, seen from above."""
    height, width = plan.cells.shape
    (x0, y0), step = plan.origin_m, plan.resolution_m
    names = sorted({room.label for room in plan.rooms})
    colors = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(names)}
    figure = apply_style(go.Figure())
    figure.add_layout_image(
        source=_png(_image(plan, colors)),
        xref="x", yref="y", x=x0, y=y0 + height * step, sizex=width * step, sizey=height * step,
        sizing="stretch", layer="below",
    )  # fmt: skip
    positions = se3.transform(plan.T_plan_map, plan.positions_map)
    x, y = _joined([positions[list(way), :2].round(3) for way in plan.ways])
    figure.add_scatter(
        x=x,
        y=y,
        mode="lines",
        name="path of the camera",
        line={"color": COLORS["text"], "width": 1.5},
        hoverinfo="skip",
    )
    for room in plan.rooms:
        at = positions[list(room.keyframe_ids)]
        figure.add_scatter(
            x=at[:, 0].round(3),
            y=at[:, 1].round(3),
            mode="markers",
            name=room.label,
            legendgroup=room.label,
            showlegend=room.id == min(r.id for r in plan.rooms if r.label == room.label),
            marker={"color": colors[room.label], "size": 6},
            text=[f"keyframe {k}, {room.label} {room.id}" for k in room.keyframe_ids],
            hovertemplate="%{text}<extra></extra>",
        )
        middle = at[np.linalg.norm(at[:, :2] - np.median(at[:, :2], axis=0), axis=1).argmin()]
        figure.add_annotation(
            x=float(middle[0]), y=float(middle[1]), text=f"<b>{room.label}</b>", showarrow=False,
            yshift=14, bgcolor="rgba(255,255,255,0.75)", font={"color": colors[room.label]},
        )  # fmt: skip
    figure.update_xaxes(range=[x0, x0 + width * step], title="ahead of the first camera (m)")
    figure.update_yaxes(
        range=[y0, y0 + height * step], scaleanchor="x", scaleratio=1, title="left (m)"
    )
    return figure.update_layout(height=620, xaxis_showgrid=False, yaxis_showgrid=False)


def _image(plan: Plan, colors: dict[str, str]) -> NDArray[np.uint8]:
    """Return the plan as (rows, columns, 3) RGB: occupied dark, unknown grey, free by room."""
    image = np.full((*plan.cells.shape, 3), 238, np.uint8)
    free = plan.cells == FREE
    image[free] = 255
    keyframes = [k for room in plan.rooms for k in room.keyframe_ids]
    if keyframes and free.any():
        room_colors = np.array(
            [_rgb(colors[room.label]) for room in plan.rooms for _ in room.keyframe_ids]
        )
        at = se3.transform(plan.T_plan_map, plan.positions_map[keyframes])[:, :2]
        rows, columns = np.nonzero(free)
        centers = np.stack([columns + 0.5, len(plan.cells) - rows - 0.5], axis=1)
        distance_m, nearest = cKDTree(at).query(centers * plan.resolution_m + plan.origin_m)
        near = distance_m <= ROOM_REACH_M
        tinted = ROOM_SHARE * room_colors[nearest[near]] + (1.0 - ROOM_SHARE) * 255
        image[rows[near], columns[near]] = tinted.astype(np.uint8)
    image[plan.cells == OCCUPIED] = _rgb(COLORS["text"])
    return image


def _joined(ways: Sequence[Array]) -> tuple[list[float | None], list[float | None]]:
    """Return x and y of ways (N, 2) as one line with gaps."""
    points = [point for way in ways for point in (*way.tolist(), (None, None))]
    return [x for x, _ in points], [y for _, y in points]


def _rgb(color: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(color.removeprefix("#")))


def _png(image: NDArray[np.uint8]) -> str:
    """Return an image as the address of its data."""
    _, png = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode()
