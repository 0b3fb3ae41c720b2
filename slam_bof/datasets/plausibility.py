"""What a sequence or an image assumes about its camera and its unit of depth, checked first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slam_bof.datasets.depth_images import CAMERA_FILE
from slam_bof.errors import DatasetError
from slam_bof.ports import Dataset
from slam_bof.types import DepthFrame, Intrinsics, SensorParams

__all__ = ["doubts_of_depth", "doubts_of_image", "find_doubts"]

N_FRAMES = 5
"""Number of frames that are looked at."""
MIN_DEPTH_M, MAX_DEPTH_M = 0.1, 8.0
"""Depth of rooms."""
TYPICAL_DEPTH_M = 2.0
"""Median depth of a room. Of several units that fit, the one that comes nearest is listed first."""
MIN_PLAUSIBLE = 0.9
"""Least share of the depth that a unit must bring into the range to be named."""
TOO_FAR = {
    4.0: "units of 0.25 mm, as of RealSense L515",
    5.0: "units of 0.2 mm, as in TUM's files",
    10.0: "units of 0.1 mm, as of RealSense D405",
    1000.0: "millimetres read as metres",
}
TOO_NEAR = {
    1 / 5: "millimetres read as units of 0.2 mm",
    1 / 10: "millimetres read as units of 0.1 mm, or centimetres as millimetres",
    1 / 1000: "metres read as millimetres",
}
"""Factors by which depth is wrong if its unit is, and the usual cause."""
REACH = 0.95
"""Quantile of the depths of a sequence or an image that counts as how far it reaches."""
MIN_REACH_M, MIN_REACH_OF_IMAGE_M = 1.0, 0.5
"""Least plausible reach of a sequence and of a single image, which may be a close-up. Sequences of
rooms reach 2.5 m at least."""
SWAPPED = 0.25
"""Share of its distance from the middle of the image at which the principal point lies from that of
the transposed image, below which its coordinates count as swapped."""


def find_doubts(dataset: Dataset, sensor: SensorParams | None = None) -> list[str]:
    """Return sentences on what is implausible about a sequence, for warnings.

    Depth is in doubt if more than half of it, in a few frames, lies outside of the range of the
    sensor, by default 0.1 to 8 m, or if nearly all is nearer than 1 m; then its unit is probably
    another. A camera is in doubt whose
    principal point fits the image turned by 90 degrees much better.
    """
    remedy = f"depth_scale, the units per metre, is an option of bags and a key of {CAMERA_FILE}"
    of_depth = doubts_of_depth(_sample(dataset), sensor)
    return [*(f"{doubt}; {remedy}" for doubt in of_depth), *_doubt_camera(dataset.intrinsics)]


def doubts_of_image(frame: DepthFrame) -> list[str]:
    """Return sentences on what is implausible about a single depth image, like ``find_doubts``.

    An image without any depth is in doubt as well.
    """
    depth_m = frame.depth_m()
    if not depth_m.any():
        return ["no pixel has a depth"]
    of_depth = doubts_of_depth(depth_m[depth_m > 0], min_reach_m=MIN_REACH_OF_IMAGE_M)
    return [*of_depth, *_doubt_camera(frame.intrinsics)]


def _sample(dataset: Dataset) -> NDArray[np.float32]:
    """Return all depths of a few frames, (N,) in metres."""
    depths = [np.empty(0, np.float32)]
    for index in np.unique(np.linspace(0, len(dataset) - 1, N_FRAMES).astype(int)).tolist():
        try:
            depth_m = dataset.frame(index).depth_m(4)
        except DatasetError:
            continue  # the run says so
        depths.append(depth_m[depth_m > 0])
    return np.concatenate(depths)


def doubts_of_depth(
    depth_m: NDArray[np.float32],
    sensor: SensorParams | None = None,
    *,
    min_reach_m: float = MIN_REACH_M,
) -> list[str]:
    """Return a sentence if depths (N,), in metres, are probably in another unit.

    Most lie outside of the range of the sensor, or nearly all are nearer than ``min_reach_m``.
    """
    sensor = sensor or SensorParams()
    if len(depth_m) == 0:
        return []
    near, far = np.mean(depth_m < sensor.min_depth_m), np.mean(depth_m > sensor.max_depth_m)
    reach_m = float(np.quantile(depth_m, REACH))
    median_m = float(np.median(depth_m))
    if near + far > 0.5 and far > near:
        where = f"{far:.0%} of all depth is beyond {sensor.max_depth_m:g} m"
        where += f" (median {median_m:.3g} m), which is not used"
    elif near + far > 0.5:
        where = f"{near:.0%} of all depth is below {sensor.min_depth_m:g} m"
        where += f" (median {median_m:.3g} m), which is not used"
    elif reach_m < min(min_reach_m, sensor.max_depth_m):
        where = f"{REACH:.0%} of all depth is below {reach_m:.2g} m, nearer than rooms are"
    else:
        return []
    likely = [
        (abs(np.log(median_m / factor / TYPICAL_DEPTH_M)), factor, cause)
        for factor, cause in (TOO_FAR if far > near else TOO_NEAR).items()
        if _plausible(depth_m / factor) >= MIN_PLAUSIBLE
    ]
    listed = " or ".join(f"divided by {factor:g} ({cause})" for _, factor, cause in sorted(likely))
    return [
        f"{where}: the unit of depth is probably wrong"
        + (f"; depth would fit a room if {listed}" if listed else "")
    ]


def _plausible(depth_m: NDArray[np.float32]) -> float:
    return float(np.mean((depth_m >= MIN_DEPTH_M) & (depth_m <= MAX_DEPTH_M)))


def _doubt_camera(camera: Intrinsics) -> Iterator[str]:
    center = np.array([camera.cx, camera.cy]) + 0.5
    size = np.array([camera.width, camera.height])
    off = np.abs(center - size / 2).sum()
    if np.abs(center - size[::-1] / 2).sum() < SWAPPED * off:
        yield (
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is that of an image of "
            f"{camera.height}x{camera.width} pixels, but the images have "
            f"{camera.width}x{camera.height}: are cx and cy swapped?"
        )
