"""Sequences in boxes whose size tells their scene label."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from conftest import CAMERA, box_room_depth_mm

from slam_bof.geometry import se3

SIZES_M = {"hall": (0.8, 1.3, 4.0), "office": (2.0, 1.5, 2.5), "store": (1.2, 2.2, 1.2)}


def write_box(folder: Path, label: str, n: int = 12, *, turned: float = 0.0) -> None:
    """Write a turn in a box whose size is of the label, in 7-Scenes layout."""
    folder.mkdir(parents=True)
    for number in range(n):
        T = se3.exp(np.array([0, turned + 0.2 * number, 0, 0.02 * number, 0, 0]))
        depth = box_room_depth_mm(CAMERA, T, SIZES_M[label])
        cv2.imwrite(str(folder / f"frame-{number:06d}.depth.png"), depth)
