"""A run as it goes on, in the viewer of rerun, or recorded in a file for it."""

from __future__ import annotations

import colorsys
import time
import zlib
from types import ModuleType
from typing import Any, Self

import numpy as np

from slam_bof.errors import DatasetError, PluginError
from slam_bof.geometry import se3, view_points
from slam_bof.ports import Dataset, Observer
from slam_bof.types import Array, Candidate, Decision, EdgeKind, Keyframe, Scene, Step

__all__ = ["LIVE", "LiveView"]

LIVE = "live"
"""In place of a file: open the viewer."""


class LiveView:
    """An observer that shows each step, and informs another observer.

    The timeline ``frame`` has the camera, the path with and without loops, the points of each
    keyframe in the colour of its label, loops, every pair that was considered with the reason of
    the decision, open directions, lost frames, and the time that each frame took.

    Parameters
    ----------
    observer
        The other observer.
    dataset
        The sequence; images of keyframes are read from it again.
    target
        ``live``, or the .rrd file to write.

    Raises
    ------
    PluginError
        If rerun is not installed.
    """

    def __init__(self, observer: Observer, dataset: Dataset, target: str) -> None:
        self._rr = rr = _import_rerun()
        self._observer, self._dataset = observer, dataset
        self._recording = rr.RecordingStream("slam_bof", recording_id=dataset.sequence)
        if target == LIVE:
            self._recording.spawn()
        else:
            self._recording.save(target)
        self._log("map", rr.ViewCoordinates.RDF, static=True)
        self._positions: dict[int, Array] = {}
        self._paths: dict[str, list[Array]] = {"map/path": [], "map/odometry": []}
        self._last_s = time.perf_counter()

    def __enter__(self) -> Self:
        """Return the view itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Write what has not been written yet."""
        self._recording.disconnect()

    def on_start(self, n_frames: int) -> None:
        """Inform the other observer."""
        self._observer.on_start(n_frames)

    def on_step(self, frame_index: int, step: Step) -> None:
        """Show a step, and inform the other observer."""
        self._observer.on_step(frame_index, step)
        now_s = time.perf_counter()
        self._recording.set_time("frame", sequence=frame_index)
        self._log("time/frame_ms", self._rr.Scalars(1e3 * (now_s - self._last_s)))
        self._log("health/open_directions", self._rr.Scalars(float(step.open_axes.shape[1])))
        self._log("health/lost", self._rr.Scalars(float(step.is_lost)))
        if step.T_map_camera is not None:
            T_odom_camera = se3.inverse(step.T_map_odom) @ step.T_map_camera
            self._paths["map/path"].append(step.T_map_camera[:3, 3])
            self._paths["map/odometry"].append(T_odom_camera[:3, 3])
            self._show_camera(step.T_map_camera)
            if step.keyframe is not None:
                self._show_keyframe(frame_index, step.keyframe, step.T_map_camera)
        for loop in step.loops:
            if loop.kind == EdgeKind.LOOP:
                self._show_loop(loop.query_id, loop.match_id)
        for candidate in step.candidates:
            if candidate.kind == EdgeKind.LOOP:
                self._tell(candidate)
        self._last_s = time.perf_counter()

    def on_warning(self, message: str) -> None:
        """Show a warning, and inform the other observer."""
        self._log("warnings", self._rr.TextLog(message, level="WARN"))
        self._observer.on_warning(message)

    def _show_camera(self, T_map_camera: Array) -> None:
        R, t = T_map_camera[:3, :3], T_map_camera[:3, 3]
        self._log("map/camera", self._rr.Transform3D(translation=t, mat3x3=R))

    def _show_keyframe(self, frame_index: int, keyframe: Keyframe, T_map_camera: Array) -> None:
        """Show a keyframe's depth and points, and the way to it."""
        rr, scene = self._rr, keyframe.smoothed or keyframe.scene
        self._positions[keyframe.id] = T_map_camera[:3, 3]
        for name, path in self._paths.items():
            self._log(f"{name}/{keyframe.id}", rr.LineStrips3D([path], colors=[COLORS[name]]))
            del path[:-1]
        if scene is not None:
            self._log("scene", rr.TextLog(f"{scene.label}, probability {scene.probability:.2f}"))
        try:
            frame = self._dataset.frame(frame_index)
        except DatasetError:
            return  # it was warned of
        camera = frame.intrinsics
        K = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        size = [camera.width, camera.height]
        self._log("map/camera/depth", rr.Pinhole(image_from_camera=K, resolution=size))
        self._log("map/camera/depth", rr.DepthImage(frame.depth_in_range_m(), meter=1.0))
        points = se3.transform(T_map_camera, view_points(frame).astype(np.float64))
        self._log(
            f"map/points/{keyframe.id}",
            rr.Points3D(points.astype(np.float32), colors=[_color(scene)], radii=0.01),
        )

    def _show_loop(self, query_id: int, match_id: int) -> None:
        ends = [self._positions.get(k) for k in (query_id, match_id)]
        if all(end is not None for end in ends):
            strip = self._rr.LineStrips3D([ends], colors=[COLORS["loop"]])
            self._log(f"map/loops/{query_id}-{match_id}", strip)

    def _tell(self, candidate: Candidate) -> None:
        text = f"{candidate.query_id} with {candidate.match_id}: {candidate.decision}"
        reason = f": {candidate.reason}" if candidate.reason else ""
        level = "INFO" if candidate.decision == Decision.ACCEPTED else "DEBUG"
        self._log("loops", self._rr.TextLog(text + reason, level=level))

    def _log(self, path: str, content: Any, **options: Any) -> None:
        self._recording.log(path, content, **options)


COLORS = {"map/path": (47, 109, 181), "map/odometry": (208, 138, 78), "loop": (58, 154, 106)}


def _import_rerun() -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise PluginError(
            "--view: found no rerun, expected it installed: pip install 'slam-bof[view]'"
        ) from error
    module: ModuleType = rerun
    return module


def _color(scene: Scene | None) -> tuple[int, ...]:
    """Return the colour of a label, always the same one; grey without a label."""
    if scene is None:
        return 150, 150, 150
    hue = zlib.crc32(scene.label.encode()) % 360 / 360
    return tuple(round(255 * part) for part in colorsys.hsv_to_rgb(hue, 0.6, 0.85))
