"""A run as it goes on, in the viewer of rerun, or recorded in a file for it."""

from __future__ import annotations

import math
import time
from typing import Self

from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.ports import Dataset, Observer
from slam_bof.types import Array, Keyframe, Pose, Step
from slam_bof.visualization.rerun_recording import MapSpace, RerunRecording

__all__ = ["LiveView"]


class LiveView:
    """An observer that shows each step, and informs another observer.

    The timeline ``frame`` has the camera, the path with and without loops, each keyframe and its
    points in the colour of its label, loops, every pair that was considered with the reason of the
    decision, open directions, lost frames, and the time that each frame took. Corrected path and
    rooms come at the end, see ``maps.show_finished_map``.

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
    OSError
        If the file cannot be written.
    """

    def __init__(self, observer: Observer, dataset: Dataset, target: str) -> None:
        self.recording = RerunRecording(dataset.sequence, target)
        self._observer, self._dataset = observer, dataset
        self.recording.arrange(["map"], series=["health", "uncertainty", "time"])
        self._map = MapSpace(self.recording)
        self._paths: dict[str, list[Array]] = {"path": [], "odometry": []}
        self._last_s = time.perf_counter()

    def __enter__(self) -> Self:
        """Return the view itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Write what has not been written yet."""
        self.recording.__exit__(*error)

    def on_start(self, n_frames: int) -> None:
        """Inform the other observer."""
        self._observer.on_start(n_frames)

    def on_step(self, frame_index: int, step: Step) -> None:
        """Show a step, and inform the other observer."""
        self._observer.on_step(frame_index, step)
        now_s = time.perf_counter()
        self.recording.set_time("frame", frame_index)
        self._plot("time/frame_ms", 1e3 * (now_s - self._last_s))
        self._plot("health/open_directions", step.open_axes.shape[1])
        self._plot("health/lost", step.is_lost)
        if step.covariance is not None and step.health == "tracked":
            variance_m2 = float(step.covariance[:3, :3].trace())
            self._plot("uncertainty/position_m", math.sqrt(variance_m2))
        if step.T_map_camera is not None:
            T_odom_camera = se3.inverse(step.T_map_odom) @ step.T_map_camera
            self._paths["path"].append(step.T_map_camera[:3, 3])
            self._paths["odometry"].append(T_odom_camera[:3, 3])
            self._map.show_camera(step.T_map_camera)
            if step.keyframe is not None:
                self._show_keyframe(frame_index, step.keyframe, step.T_map_camera)
        for loop in step.loops:
            self._map.show_loop(loop)
        for candidate in step.candidates:
            self.recording.log_candidate(candidate)
        if step.candidates:
            self._map.show_refused(step.candidates)
        self._last_s = time.perf_counter()

    def on_warning(self, message: str) -> None:
        """Show a warning, and inform the other observer."""
        self.recording.log("warnings", self.recording.rr.TextLog(message, level="WARN"))
        self._observer.on_warning(message)

    def _show_keyframe(self, frame_index: int, keyframe: Keyframe, T_map_camera: Pose) -> None:
        """Show a keyframe's depth and points, and the way to it."""
        scene = keyframe.smoothed or keyframe.scene
        label = scene.label if scene else None
        self._map.show_keyframe(keyframe.id, T_map_camera, label)
        for name, path in self._paths.items():
            self._map.show_path(name, keyframe.id, path)
            del path[:-1]
        self.recording.log_scene(scene)
        try:
            frame = self._dataset.frame(frame_index)
        except DatasetError:
            return  # it was warned of
        self._map.show_frame(keyframe.id, frame, T_map_camera, label)

    def _plot(self, path: str, value: float) -> None:
        self.recording.log(path, self.recording.rr.Scalars(float(value)))
