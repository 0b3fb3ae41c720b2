"""A model of a structured-light depth camera: noise, quantisation, shadows and gaps.

Noise after Nguyen, Izadi and Lovell, *Modeling Kinect sensor noise for improved 3D
reconstruction and tracking* (3DIMPVT 2012): the axial standard deviation grows with the
square of depth, the lateral one is just under a pixel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.types import INVALID_DEPTH_MM, Params

__all__ = ["SensorModelParams", "sense"]


class SensorModelParams(Params):
    """Parameters of the depth camera, by default the Kinect of 7-Scenes.

    ``focal_px`` times ``baseline_m`` over z is the disparity, measured in steps of
    ``disparity_step_px``. A reading's standard deviation, steps included, is
    ``noise_floor_m + noise_growth * (z - 0.4)^2``; ``noise_grain_px`` is how far neighbours
    share it. Edges wander by ``lateral_px``. Lost in patches of ``patch_px`` are the share
    ``edge_loss`` of edges where depth jumps by more than ``edge_ratio`` of it, and surfaces that
    return less light than ``weak_return`` (grazing or dark ones), the more the less;
    single pixels with the chance ``speckle_loss``; and the right ``border_px`` columns.
    """

    focal_px: float = 585.0
    baseline_m: float = 0.075
    disparity_step_px: float = 0.125
    noise_floor_m: float = 0.0012
    noise_growth: float = 0.0019
    noise_grain_px: float = 1.2
    lateral_px: float = 0.8
    edge_ratio: float = 0.03
    edge_loss: float = 0.4
    weak_return: float = 0.3
    patch_px: int = 6
    speckle_loss: float = 0.0002
    border_px: int = 8
    min_range_m: float = 0.4
    max_range_m: float = 4.5


def sense(
    depth_m: NDArray[np.float32],
    returned: NDArray[np.float32],
    rng: np.random.Generator,
    params: SensorModelParams | None = None,
) -> NDArray[np.uint16]:
    """Return the measurement of true depth by the sensor.

    Parameters
    ----------
    depth_m
        (H, W) true z in metres, 0 where there is nothing.
    returned
        (H, W) share of the light that comes back, as in ``View.returned``.
    rng
        Random generator of the noise.
    params
        Parameters of the sensor.

    Returns
    -------
    NDArray[np.uint16]
        (H, W) millimetres; 0 where shadow, edge, weak return or chance lost the pixel, and 65535
        where the surface is out of range.
    """
    p = SensorModelParams() if params is None else params
    depth = depth_m.astype(np.float32)
    edge = _edges(depth, p.edge_ratio)
    depth = _jitter(depth, edge, rng, p.lateral_px)
    chance = _patches(depth.shape, rng, p.patch_px)
    lost = edge & (chance < p.edge_loss)
    lost |= chance * p.weak_return > returned
    lost |= _shadow(depth, p.focal_px * p.baseline_m)
    single = rng.integers(0, lost.size, round(p.speckle_loss * lost.size))
    lost.reshape(-1)[single] = True
    lost[:, lost.shape[1] - p.border_px :] = True

    outside = (depth < p.min_range_m) | (depth > p.max_range_m)
    safe = np.where(outside, np.float32(1.0), depth)
    steps = np.float32(p.focal_px * p.baseline_m / p.disparity_step_px)
    total = p.noise_floor_m + p.noise_growth * np.square(safe - 0.4)
    # The published deviation is that of readings: the steps' share of it comes by rounding.
    rounding = np.square(safe) / steps / np.sqrt(12.0)
    sigma = np.sqrt(np.maximum(np.square(total) - np.square(rounding), 0.0))
    noisy = safe + sigma * _grain(depth.shape, rng, p.noise_grain_px)
    measured_m = steps / np.round(steps / noisy)
    out: NDArray[np.uint16] = np.round(1000.0 * measured_m).astype(np.uint16)
    out[outside] = INVALID_DEPTH_MM
    out[lost & (depth > 0)] = 0
    return out


def _patches(
    shape: tuple[int, ...], rng: np.random.Generator, patch_px: int
) -> NDArray[np.float32]:
    """Return uniform random numbers that neighbouring pixels share."""
    height, width = shape
    coarse = rng.random((height // patch_px + 1, width // patch_px + 1), dtype=np.float32)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR))


def _edges(depth: NDArray[np.float32], ratio: float) -> NDArray[np.bool_]:
    """Find the pixels whose 3x3 neighbourhood jumps by more than a share of its depth."""
    window = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(depth, window), cv2.dilate(depth, window)
    return np.asarray(high - low > ratio * high)


def _jitter(
    depth: NDArray[np.float32], edge: NDArray[np.bool_], rng: np.random.Generator, sigma: float
) -> NDArray[np.float32]:
    """Give every pixel at an edge the depth of a nearby pixel."""
    height, width = depth.shape
    v, u = np.nonzero(edge)
    shift = np.round(rng.normal(0.0, sigma, (2, len(v)))).astype(np.int64)
    out = depth.copy()
    out[v, u] = depth[np.clip(v + shift[0], 0, height - 1), np.clip(u + shift[1], 0, width - 1)]
    return out


def _shadow(depth: NDArray[np.float32], focal_baseline: float) -> NDArray[np.bool_]:
    """Return the pixels in the shadow of the projector, which is to the right of the camera.

    A point in column u lies in the projector's column u - disparity; it is in the shadow of a
    point further right in the camera's image that the projector has at or left of it.
    """
    u = np.arange(depth.shape[1], dtype=np.float32)
    seen = depth > 0
    projector = np.where(seen, u - focal_baseline / np.where(seen, depth, 1.0), np.inf)
    leftmost = np.minimum.accumulate(projector[:, ::-1], axis=1)[:, ::-1]
    # Half a pixel of tolerance: surfaces seen edge-on are the grazing rule's.
    return np.asarray(leftmost < projector - 0.5)


def _grain(
    shape: tuple[int, ...], rng: np.random.Generator, sigma_px: float
) -> NDArray[np.float32]:
    """Return unit noise that neighbours share, because the sensor matches windows of pixels."""
    noise = rng.standard_normal(shape, dtype=np.float32)
    if sigma_px <= 0:
        return noise
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma_px)
    # The kernel sums to 1, so the variance falls to the sum of its squares, about this.
    return np.asarray(smooth * np.float32(2.0 * np.sqrt(np.pi) * sigma_px))
