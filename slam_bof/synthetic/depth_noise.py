"""Depth sensors that err in different ways: white noise, structured light, time of flight, phone.

Each is a small camera with a model of its noise, so that tuning to one of them shows on the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.synthetic.scene import View
from slam_bof.synthetic.sensor import SensorModelParams, sense
from slam_bof.types import Intrinsics

__all__ = ["SENSORS", "DepthSensor"]

Image = NDArray[np.float32]
KINECT_HALF = Intrinsics(320, 240, 292.5, 292.5, 160.0, 120.0)
TOF_CAMERA = Intrinsics(320, 288, 252.0, 252.0, 160.0, 144.0)
PHONE_CAMERA = Intrinsics(256, 192, 212.0, 212.0, 128.0, 96.0)


@dataclass(frozen=True, slots=True)
class DepthSensor:
    """A camera, and what it measures (H, W) uint16 mm, 0 where nothing, of a perfect view."""

    intrinsics: Intrinsics
    measure: Callable[[View, np.random.Generator], NDArray[np.uint16]]


def with_holes(
    depth_mm: NDArray[np.uint16], share: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """Lose a share of all pixels, as before glass: half of them in patches, half one by one."""
    patches = _smooth(depth_mm.shape, rng, 4.0)
    kept_share = np.sqrt(1.0 - share)
    kept = patches < np.quantile(patches, kept_share)
    kept &= rng.random(depth_mm.shape) < kept_share
    return np.where(kept, depth_mm, np.uint16(0))


def _white(view: View, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Err by 0.2 % of depth, each pixel by itself."""
    depth_m = view.depth_m
    noisy = depth_m * (1.0 + 0.002 * rng.standard_normal(depth_m.shape, dtype=np.float32))
    return _millimetres(noisy, (depth_m > 0.2) & (depth_m < 6.0))


def _kinect(view: View, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Measure as the Kinect of 7-Scenes does, at half its resolution."""
    params = SensorModelParams(focal_px=585.0, lateral_px=0.5, patch_px=3, border_px=4)
    return sense(view.depth_m, view.returned, rng, params)


def _tof(view: View, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Measure as a time-of-flight camera: weak light is noisy, weaker is lost; edges are mixed."""
    depth_m = view.depth_m
    light = view.returned / np.maximum(np.square(depth_m), 0.25)
    sigma_m = 0.001 + 0.0015 * depth_m / np.sqrt(np.maximum(light, 1e-3)).clip(0.05, 1.0)
    mixed = cv2.GaussianBlur(depth_m, (0, 0), 0.6)
    # The distortion that an uneven phase response leaves: centimetre waves over depth.
    wiggle_m = 0.003 * np.sin(depth_m * (2.0 * np.pi / 0.6))
    noisy = mixed + wiggle_m + sigma_m * rng.standard_normal(depth_m.shape, dtype=np.float32)
    chance = rng.random(depth_m.shape, dtype=np.float32)
    seen = (depth_m > 0.2) & (depth_m < 5.0) & (light > 0.01 + 0.03 * chance)
    return _millimetres(noisy, seen)


def _phone(view: View, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Measure as a phone's fused depth: without holes, its edges round, its errors smooth."""
    depth_m = view.depth_m
    smoothed = cv2.GaussianBlur(np.minimum(depth_m, 8.0), (0, 0), 2.0)
    waves = _smooth(depth_m.shape, rng, 12.0)
    noisy = smoothed * (1.0 + 0.004 * waves)
    return _millimetres(noisy, (depth_m > 0.2) & (depth_m < 8.0))


def _smooth(shape: tuple[int, ...], rng: np.random.Generator, sigma_px: float) -> Image:
    """Return noise of unit variance that is correlated over this many pixels."""
    height, width = shape
    small = (round(width / sigma_px) + 3, round(height / sigma_px) + 3)
    coarse = rng.standard_normal((small[1], small[0]), dtype=np.float32)
    wide = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(wide / max(float(wide.std()), 1e-6))


def _millimetres(depth_m: Image, seen: NDArray[np.bool_]) -> NDArray[np.uint16]:
    return np.where(seen, np.clip(np.rint(1000.0 * depth_m), 0, 65534), 0).astype(np.uint16)


SENSORS = {
    "white": DepthSensor(KINECT_HALF, _white),
    "kinect": DepthSensor(KINECT_HALF, _kinect),
    "tof": DepthSensor(TOF_CAMERA, _tof),
    "phone": DepthSensor(PHONE_CAMERA, _phone),
}
