"""Depth images as other sensors would have measured them, for training.

A scene classifier must not learn the sensor. Every training image is shown several times, each
time mirrored or not, cut to another field of view, and measured by another sensor: steps,
noise, smoothing, holes and range are drawn at random, with the same chances for real and
synthetic images, whatever they were recorded with.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from slam_bof.types import Array, DepthFrame, Intrinsics

__all__ = ["remeasure", "remeasure_labelled"]

Depth = NDArray[np.float32]

WIDTH_PX = 320
"""Approximate width of the image before it is cut; features need no more."""
MIN_CROP = 0.8
"""Least share of the image's width and height that a cut leaves."""
MAX_SCALE_CHANGE = 0.04
"""Largest relative error of the sensor's scale."""
MAX_RANGE_M = (3.5, 9.0)
"""The sensor's range is drawn from this interval."""
STEP_8_BIT_M = 0.0392
"""Steps of depth that is stored in 8 bits over 10 m."""


def remeasure(
    frame: DepthFrame, rng: np.random.Generator, gravity_camera: Array | None = None
) -> tuple[DepthFrame, Array | None]:
    """Return the frame as a sensor drawn at random would have measured it, and gravity in it.

    The frame has float metres, about ``WIDTH_PX`` columns before it is cut, and intrinsics of its
    own. ``gravity_camera`` (3,) is the direction of gravity, if known.
    """
    labels = np.zeros((frame.intrinsics.height, frame.intrinsics.width), np.uint8)
    measured, gravity_camera, _ = remeasure_labelled(frame, labels, rng, gravity_camera)
    return measured, gravity_camera


def remeasure_labelled(
    frame: DepthFrame,
    labels: NDArray[np.uint8],
    rng: np.random.Generator,
    gravity_camera: Array | None = None,
) -> tuple[DepthFrame, Array | None, NDArray[np.uint8]]:
    """Return what ``remeasure`` returns, and the labels of its pixels.

    ``labels`` has one for each pixel of the frame, and the result one for each of its.
    """
    stride = max(1, frame.intrinsics.width // WIDTH_PX)
    depth = frame.depth_m(stride).astype(np.float32)
    camera = _strided(frame.intrinsics, depth.shape, stride)
    top, left, height, width = _window(depth.shape, rng)
    window = np.s_[top : top + height, left : left + width]
    depth, labels = depth[window].copy(), labels[::stride, ::stride][window]
    camera = replace(camera, width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
    if rng.random() < 0.5:
        depth = np.ascontiguousarray(depth[:, ::-1])
        labels = labels[:, ::-1]
        camera = replace(camera, cx=camera.width - 1 - camera.cx)
        if gravity_camera is not None:
            gravity_camera = gravity_camera * (-1.0, 1.0, 1.0)
    depth *= np.float32(1.0 + rng.uniform(-MAX_SCALE_CHANGE, MAX_SCALE_CHANGE))
    measured = _measure(depth, rng)
    measured[_lost(depth, rng)] = 0.0
    measured[measured > rng.uniform(*MAX_RANGE_M)] = 0.0
    return DepthFrame(frame.stamp_s, measured, camera), gravity_camera, labels


def _strided(camera: Intrinsics, shape: tuple[int, ...], stride: int) -> Intrinsics:
    height, width = shape
    focal_and_center = (camera.fx, camera.fy, camera.cx, camera.cy)
    return Intrinsics(width, height, *(value / stride for value in focal_and_center))


def _window(shape: tuple[int, ...], rng: np.random.Generator) -> tuple[int, int, int, int]:
    """Draw a window of an image: top, left, height and width in pixels."""
    size = np.array(shape)
    kept = np.round(size * rng.uniform(MIN_CROP, 1.0, 2)).astype(int)
    top, left = rng.integers(0, size - kept + 1).tolist()
    height, width = kept.tolist()
    return top, left, height, width


def _measure(depth: Depth, rng: np.random.Generator) -> Depth:
    """Return depth with the noise, steps and smoothing of one kind of sensor."""
    measured: NDArray[np.floating[Any]]
    kind = rng.integers(5)
    if kind == 0:  # structured light: noise and steps that grow with the square of depth
        noisy = depth + _noise(depth.shape, rng, 1.2) * (0.001 + 0.0019 * depth**2)
        measured = 350.0 / np.maximum(np.round(350.0 / np.maximum(noisy, 0.1)), 1.0)
    elif kind == 1:  # stereo: patchy noise
        growth = rng.uniform(0.002, 0.006)
        measured = depth + _noise(depth.shape, rng, rng.uniform(2.0, 5.0)) * growth * depth**2
    elif kind == 2:  # time of flight: noise of single pixels that grows slowly
        measured = depth + _noise(depth.shape, rng, 0.0) * (0.004 + 0.003 * depth)
    elif kind == 3:  # dense depth completed by a network: smooth, with rounded edges
        measured = _smoothed(depth, rng.uniform(1.0, 2.5))
    else:  # stored in 8 bits
        smooth = _smoothed(depth, rng.uniform(0.3, 1.5))
        measured = (np.floor(smooth / STEP_8_BIT_M) + 0.5) * STEP_8_BIT_M
    return np.where(depth > 0.0, np.maximum(measured, 0.0), 0.0).astype(np.float32)


def _lost(depth: Depth, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the pixels lost: patches, shadows beside depth edges, and borders."""
    share = rng.choice((0.0, 0.02, 0.1, 0.2)) * rng.random()
    lost = _noise(depth.shape, rng, rng.uniform(2.0, 8.0)) > _quantile(share)
    if rng.random() < 0.6:
        width_px = int(rng.integers(1, 5))
        near = cv2.erode(np.where(depth > 0, depth, 99.0), np.ones((1, 2 * width_px + 1)))
        lost |= depth > 1.08 * near
    border_px = int(rng.integers(0, 5))
    lost[:, depth.shape[1] - border_px :] = True
    return np.asarray(lost)


def _noise(shape: tuple[int, ...], rng: np.random.Generator, grain_px: float) -> Depth:
    """Return unit noise that neighbours share within about ``grain_px``."""
    noise = rng.standard_normal(shape, dtype=np.float32)
    if grain_px <= 0.0:
        return noise
    smooth = cv2.GaussianBlur(noise, (0, 0), grain_px)
    return np.asarray(smooth / max(float(smooth.std()), 1e-6), np.float32)


def _quantile(share: float) -> float:
    """Return the value that unit noise exceeds with the probability ``share``."""
    return float(-ndtri(share)) if share > 0.0 else np.inf


def _smoothed(depth: Depth, sigma_px: float) -> Depth:
    """Blur depth where it is known."""
    known = (depth > 0.0).astype(np.float32)
    weight = cv2.GaussianBlur(known, (0, 0), sigma_px)
    blurred = cv2.GaussianBlur(depth, (0, 0), sigma_px)
    return np.asarray(blurred / np.maximum(weight, 1e-3), np.float32)
