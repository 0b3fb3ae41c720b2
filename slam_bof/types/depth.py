"""Depth images and their camera."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from slam_bof.types.parameters import Params

__all__ = [
    "INVALID_DEPTH_MM",
    "MAX_PIXELS",
    "DepthFrame",
    "Intrinsics",
    "SensorParams",
    "SubsampledDepth",
]

INVALID_DEPTH_MM = 65535
"""Value of a pixel without depth in 7-Scenes files; 0 has the same meaning."""

MIN_FOCAL = 0.05
"""Smallest plausible focal length, as a share of the image's size along the same axis."""
MAX_FOCAL = 100.0
"""Largest plausible focal length, likewise: a field of view of 0.6 degrees."""
MAX_CENTER = 0.95
"""Largest plausible coordinate of the principal point, as a share of the image's size."""
MAX_DEPTH_M = 1e12
"""Largest plausible depth in metres; beyond it, the unit is another."""
MAX_PIXELS = 1 << 24
"""Largest plausible number of pixels of a depth image; depth cameras have up to some 5 million."""
SAME_CAMERA = 0.005
"""Largest relative difference of the intrinsics of one camera, whose focus may move a little."""

Derived = TypeVar("Derived")


class SensorParams(Params):
    """Parameters of the depth sensor. Pixels outside its range count as missing."""

    min_depth_m: float = Field(0.1, ge=0, description="Smallest depth in metres that is used.")
    max_depth_m: float = Field(
        8.0, gt=0, le=60, description="Largest depth in metres that is used."
    )
    depth_scale: float = Field(
        1.0,
        gt=0.5,
        lt=2.0,
        description="Factor that measured depth is multiplied by; slam-bof check estimates it.",
    )
    edge_ratio: float = Field(
        0.1,
        gt=0,
        description="Difference in depth between neighbouring pixels, as a share of 1 m plus the "
        "depth, from which they count as an edge without surface normal.",
    )

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.min_depth_m >= self.max_depth_m:
            raise ValueError(
                f"min_depth_m must be below max_depth_m, got {self.min_depth_m} and "
                f"{self.max_depth_m}"
            )
        return self


DEFAULT_SENSOR = SensorParams()


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera: image size, focal lengths and principal point, all in pixels.

    Raises
    ------
    ValueError
        If the numbers cannot be of a camera with such images: the image has more than 16.8 million
        pixels, a focal length is not positive, below 5 % of the image's size (a field of view of
        more than 168 degrees) or above 100 times of it, or the principal point lies outside the
        image or in the 5 % along its edges.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Convert all numbers to plain ones, and check that they are plausible."""
        for name in self.__slots__:
            is_size, value = name in ("width", "height"), getattr(self, name)
            try:
                plain = operator.index(value) if is_size else float(value)
                float(plain)  # which no width or height of hundreds of digits is
            except (TypeError, ValueError, OverflowError):
                expected = "a whole number of pixels" if is_size else "a number"
                raise ValueError(f"found {name} = {value!r:.40}, expected {expected}") from None
            object.__setattr__(self, name, plain)
        if min(self.width, self.height) < 1:
            raise ValueError(f"found an image of {self.width}x{self.height} pixels, expected some")
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(
                f"found an image of {self.width}x{self.height} pixels, "
                f"expected at most {MAX_PIXELS}"
            )
        for axis, size, focal, center in (
            ("x", self.width, self.fx, self.cx),
            ("y", self.height, self.fy, self.cy),
        ):
            where = f"for an image of {self.width}x{self.height} pixels"
            low, high = MIN_FOCAL * size, MAX_CENTER * size
            if not low <= focal <= MAX_FOCAL * size:
                raise ValueError(
                    f"found a focal length f{axis} of {focal:g} px {where}, "
                    f"expected at least {low:g} px, at most {MAX_FOCAL * size:g} px"
                )
            if not size - high <= center + 0.5 <= high:
                raise ValueError(
                    f"found the principal point at c{axis} = {center:g} px {where}, expected it "
                    f"between {size - high:g} and {high:g} px"
                )

    def is_close(self, other: Intrinsics) -> bool:
        """Return whether both are of one camera, whose focus may move a little.

        The sizes are equal, the focal lengths differ by no more than 0.5 %, and the principal
        points by no more than 0.5 % of the image's size.
        """
        return (
            (self.width, self.height) == (other.width, other.height)
            and abs(self.fx - other.fx) <= SAME_CAMERA * other.fx
            and abs(self.fy - other.fy) <= SAME_CAMERA * other.fy
            and abs(self.cx - other.cx) <= SAME_CAMERA * other.width
            and abs(self.cy - other.cy) <= SAME_CAMERA * other.height
        )


@dataclass(frozen=True, slots=True, eq=False)
class DepthFrame:
    """One depth image with its time and camera.

    Parameters
    ----------
    stamp_s
        Time in seconds, on any clock that increases.
    depth
        (H, W) depth, either uint16 in millimetres (0 and 65535 mean missing) or float in metres
        (0, negative and non-finite values, and those beyond 1e12, mean missing).
    intrinsics
        Intrinsics of the depth camera for this image size.
    sensor
        Parameters of the sensor, such as the range of depths that are used.

    Raises
    ------
    ValueError
        If the size of the image differs from that of the intrinsics, its type is neither uint16
        nor float, or the time is no number.
    """

    stamp_s: float
    depth: NDArray[Any]
    intrinsics: Intrinsics
    sensor: SensorParams = DEFAULT_SENSOR
    _derived: dict[Callable[[DepthFrame], Any], Any] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        """Check shape and type once, when the frame is made; the time becomes a plain float."""
        try:
            if isinstance(self.stamp_s, bool) or not isinstance(self.stamp_s, Real):
                raise TypeError
            object.__setattr__(self, "stamp_s", float(self.stamp_s))
        except (TypeError, OverflowError):  # an integer of hundreds of digits is no float
            got = f"{self.stamp_s!r:.40}"
            raise ValueError(f"stamp_s must be a number of seconds, got {got}") from None
        if not isinstance(self.depth, np.ndarray):
            raise ValueError(f"depth must be a NumPy array, got a {type(self.depth).__name__}")
        expected = (self.intrinsics.height, self.intrinsics.width)
        if self.depth.shape != expected:
            raise ValueError(
                f"depth must be {expected} like its intrinsics, got {self.depth.shape}"
            )
        if self.depth.dtype != np.uint16 and self.depth.dtype.kind != "f":
            raise ValueError(f"depth must be uint16 mm or float m, got {self.depth.dtype}")

    def derive(self, compute: Callable[[DepthFrame], Derived]) -> Derived:
        """Return ``compute(frame)``. The result of the first call is cached in the frame.

        Tracking, recognition and verification all need the same ``DepthView`` of a frame.
        """
        if compute not in self._derived:
            self._derived[compute] = compute(self)
        derived: Derived = self._derived[compute]
        return derived

    def with_sensor(self, sensor: SensorParams) -> DepthFrame:
        """Return the frame with the parameters of a sensor."""
        return self if sensor == self.sensor else replace(self, sensor=sensor)

    def corrected(self, sensor: SensorParams) -> DepthFrame:
        """Return the frame with the parameters of a sensor, and its depth in that scale.

        A frame that has these parameters already counts as corrected.
        """
        scale = sensor.depth_scale / self.sensor.depth_scale
        if sensor == self.sensor or scale == 1.0:
            return self.with_sensor(sensor)
        return replace(self, depth=self.depth_m() * np.float32(scale), sensor=sensor)

    def depth_in_range_m(self, stride: int = 1) -> NDArray[np.float32]:
        """Return the depth as ``depth_m`` does, 0 also outside the range of the sensor."""
        depth_m = self.depth_m(stride)
        is_outside = (depth_m < self.sensor.min_depth_m) | (depth_m > self.sensor.max_depth_m)
        depth_m[is_outside] = 0.0
        return depth_m

    def depth_m(self, stride: int = 1) -> NDArray[np.float32]:
        """Return the depth of every ``stride``-th pixel in metres, 0 where it is missing."""
        depth = np.ascontiguousarray(self.depth[::stride, ::stride])
        if depth.dtype == np.uint16:
            metres = depth * np.float32(0.001)
            metres[depth == INVALID_DEPTH_MM] = 0.0
            return metres
        valid = (depth > 0) & (depth <= MAX_DEPTH_M)
        return np.where(valid, depth, 0.0).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class SubsampledDepth:
    """The pixels of a depth image that the map keeps, chosen by ``geometry.subsample``.

    ``depth`` is (h, w) uint16 in steps of 1 / ``per_m`` metres, 0 where missing. ``intrinsics``
    are those of the full image.
    """

    depth: NDArray[np.uint16]
    per_m: int
    intrinsics: Intrinsics
