"""What every data set must do, and what their tests write files with."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from slam_bof import ports
from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.types import Trajectory

WIDTH, HEIGHT = 32, 24


def check_dataset(dataset: ports.Dataset) -> None:
    """The contract: frames by index, the same each time, at growing times, all of them posed."""
    assert isinstance(dataset, ports.Dataset)
    n = len(dataset)
    assert n > 0
    first = dataset.frame(0)
    stamps_s = []
    for index in range(n):
        frame = dataset.frame(index)
        stamps_s.append(frame.stamp_s)
        assert np.isfinite(frame.depth_m()).all()
        assert frame.intrinsics.fx > 0
        assert frame.intrinsics.fy > 0
        color, gray = dataset.color(index), dataset.gray(index)
        assert color is None or color.shape == (*frame.depth.shape, 3)
        assert gray is None or (gray.ndim == 2 and gray.dtype == np.uint8)
    assert all(type(stamp_s) is float for stamp_s in stamps_s)
    assert (np.diff(stamps_s) > 0).all()
    again = dataset.frame(0)  # back to the start, after the end
    assert again.stamp_s == first.stamp_s
    np.testing.assert_array_equal(again.depth, first.depth)
    assert first.intrinsics == dataset.intrinsics
    for outside in (n, -n - 1):
        with pytest.raises(IndexError):
            dataset.frame(outside)
    groundtruth = dataset.groundtruth()
    if groundtruth is not None:
        assert len(groundtruth) == n
        np.testing.assert_allclose(groundtruth.stamps_s, stamps_s, rtol=0, atol=1e-9)
        known = np.isfinite(groundtruth.poses).all(axis=(1, 2))
        assert known.any()
        assert np.isnan(groundtruth.poses[~known]).all()
        for T in groundtruth.poses[known]:
            se3.check_rigid(T)
    scenes = dataset.scenes()
    assert scenes is None or len(scenes) == n


def refusal(name: str, path: Path, **options: object) -> str:
    """What a data set says of files that are not what they should be: one line."""
    with pytest.raises(DatasetError) as caught:
        registry.open_dataset(path, name, options or None)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def ramp(number: int = 0) -> NDArray[np.uint16]:
    """A depth image in which no two pixels are alike, other for each frame; (0, 0) is missing."""
    image = 1000 + 1000 * number + np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    image[0, 0] = 0
    return image.astype(np.uint16)


def write_png(path: Path, image: NDArray[np.generic]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    coded, data = cv2.imencode(path.suffix, image)
    assert coded
    path.write_bytes(data.tobytes())


def pose(number: float) -> NDArray[np.float64]:
    """A pose for each time, on one arc."""
    return se3.exp(np.array([0, 0.1, 0, 1.0, 0, 0.5]) * number)


def trajectory(stamps_s: list[float]) -> Trajectory:
    return Trajectory(np.array(stamps_s), np.array([pose(stamp_s) for stamp_s in stamps_s]))
