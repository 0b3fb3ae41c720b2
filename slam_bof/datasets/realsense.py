"""RealSense cameras, through the optional pyrealsense2."""

from __future__ import annotations

from typing import Any, Self

import numpy as np

from slam_bof.datasets.recording import CameraFrame
from slam_bof.errors import DatasetError, PluginError
from slam_bof.geometry import checked_intrinsics
from slam_bof.types import Intrinsics

__all__ = ["RealSense"]

TIMEOUT_MS = 5000


class RealSense:
    """A RealSense camera, on from entering the ``with`` block to leaving it.

    Depth is of the depth camera, whose images have no lens distortion; colour, if asked for, is
    moved to where depth sees it.

    Parameters
    ----------
    serial
        Serial number of the camera; by default the first one found.
    width, height, fps
        Size of the depth stream in pixels, and its rate in frames a second.
    with_color
        Whether to read colour too.

    Raises
    ------
    PluginError
        If pyrealsense2 is not installed.
    DatasetError
        If there is no such camera, or it has no such stream.
    """

    intrinsics: Intrinsics
    """Known once the camera is on."""

    def __init__(
        self,
        *,
        serial: str | None = None,
        width: int = 640,
        height: int = 480,
        fps: int = 30,
        with_color: bool = False,
    ) -> None:
        try:
            import pyrealsense2 as rs
        except ImportError as error:
            raise PluginError(
                "RealSense needs pyrealsense2, which is not installed; "
                "try: pip install slam-bof[realsense]"
            ) from error
        self._pipeline = rs.pipeline()
        self._config = rs.config()
        if serial is not None:
            self._config.enable_device(serial)
        self._config.enable_stream(rs.stream.depth, width, height, rs.format.z16, fps)
        if with_color:
            self._config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, fps)
        self._align = rs.align(rs.stream.depth) if with_color else None
        self._depth_stream = rs.stream.depth
        self._wanted = f"a camera with depth of {width}x{height} pixels at {fps} Hz"
        self.fps = float(fps)
        self.units_per_m = 1000.0

    def __enter__(self) -> Self:
        """Start the camera, and ask it for its units and intrinsics."""
        try:
            profile = self._pipeline.start(self._config)
            scale_m = profile.get_device().first_depth_sensor().get_depth_scale()
            stream = profile.get_stream(self._depth_stream).as_video_stream_profile()
            camera = stream.get_intrinsics()
        except RuntimeError as error:
            raise self._failed(error) from error
        self.units_per_m = _units_per_m(scale_m)
        self.intrinsics = checked_intrinsics(
            "RealSense",
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.ppx,
            camera.ppy,
        )
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the camera."""
        self._pipeline.stop()

    def read(self) -> CameraFrame:
        """Wait for the next frame; ``DatasetError`` if none comes within 5 s."""
        try:
            frames: Any = self._pipeline.wait_for_frames(TIMEOUT_MS)
            if self._align is not None:
                frames = self._align.process(frames)
            depth = frames.get_depth_frame()
            color = frames.get_color_frame() if self._align is not None else None
            return CameraFrame(
                float(depth.get_timestamp()) * 1e-3,
                int(depth.get_frame_number()),
                # Copies: the camera takes its memory back.
                np.array(depth.get_data(), np.uint16),
                np.array(color.get_data(), np.uint8) if color else None,
            )
        except RuntimeError as error:
            raise self._failed(error) from error

    def _failed(self, error: RuntimeError) -> DatasetError:
        reason = " ".join(str(error).split())
        return DatasetError(f"RealSense: found trouble ({reason}), expected {self._wanted}")


def _units_per_m(scale_m: float) -> float:
    """Return units a metre of metres a unit, a float32: a whole number where it is nearly one.

    >>> _units_per_m(0.0010000000474974513)
    1000.0
    """
    units = 1.0 / scale_m
    whole = float(round(units))
    return whole if abs(units - whole) < 1e-4 * units else units
