"""Depth images as small pictures for a page."""

from __future__ import annotations

import base64
import html

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_DEPTH_M", "depth_picture"]

MAX_DEPTH_M = 5.0
"""Largest depth of the colour scale."""


def depth_picture(depth_m: NDArray[np.float32], caption: str, width_px: int = 320) -> str:
    """Return a depth image (H, W) as HTML, from 0 (dark) to 5 m (bright), black where missing."""
    height = round(width_px * depth_m.shape[0] / depth_m.shape[1])
    small = cv2.resize(depth_m, (width_px, height), interpolation=cv2.INTER_NEAREST)
    levels = np.clip(255.0 * small / MAX_DEPTH_M, 0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    picture[small == 0] = 0
    _, coded = cv2.imencode(".jpg", picture)
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    caption = html.escape(caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/jpeg;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
