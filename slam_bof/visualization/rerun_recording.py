"""A recording of a run or a saved map for rerun, shown in its viewer or written to a file."""

from __future__ import annotations

import colorsys
import os
import socket
import sys
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Self

import numpy as np

from slam_bof.core import refuse_named_pipe
from slam_bof.errors import PluginError
from slam_bof.geometry import se3, view_points
from slam_bof.scenes import MapRoom
from slam_bof.types import Array, Candidate, Decision, DepthFrame, EdgeKind, Loop, Pose, Scene

__all__ = ["LIVE", "MapSpace", "RerunRecording"]

LIVE = "live"
"""Given in place of a file, it opens the viewer."""

VIEWER_PORT = 9876
"""Port at which rerun's viewer listens."""

COLORS = {
    "path": (47, 109, 181),
    "odometry": (208, 138, 78),
    "corrected": (26, 54, 110),
    "loop": (58, 154, 106),
    Decision.REJECTED: (196, 72, 72),
    Decision.HELD: (214, 184, 70),
}
VOXEL_SIZE_M = 0.03
VOXEL_KEYS = np.array([1, 1 << 21, 1 << 42])
"""Factors that make one number of a voxel's three indices; they differ within 30 km."""
GOLDEN_RATIO = 0.618
"""Step between the hues of consecutive components, so that all differ."""


class RerunRecording:
    """A recording of rerun, closed at the end of its ``with`` block.

    Parameters
    ----------
    name
        Recordings of the same name are one in the viewer.
    target
        ``live``, or the .rrd file to write.

    Raises
    ------
    PluginError
        If rerun is not installed, or there is no display to open the viewer on.
    OSError
        If the file cannot be written.
    """

    def __init__(self, name: str, target: str) -> None:
        self.rr = _import_rerun()
        if target == LIVE and not _can_show():
            raise PluginError("found no display for rerun, expected one, or a FILE.rrd to write")
        self._stream = self.rr.RecordingStream("slam_bof", recording_id=name)
        if target == LIVE:
            self._stream.spawn()
        else:
            refuse_named_pipe(Path(target))
            Path(target).open("wb").close()  # rerun's own error does not name the file
            self._stream.save(target)

    def __enter__(self) -> Self:
        """Return the recording itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Write what has not been written yet."""
        self._stream.disconnect()

    def arrange(self, spaces: Sequence[str], *, series: Sequence[str] = ()) -> None:
        """Lay out the viewer: spaces to the left, and beside them depth, texts and time series."""
        from rerun import blueprint as layout

        texts: list[Any] = [
            layout.TextLogView(origin=f"/{name}", name=name) for name in ("loops", "scene")
        ]
        if not series:  # of a saved map, which has a page of each keyframe
            texts.insert(0, layout.TextDocumentView(origin="/keyframe", name="keyframe"))
        beside = layout.Vertical(
            layout.Spatial2DView(origin=f"/{spaces[0]}/camera/depth", name="depth"),
            layout.Tabs(*texts),
            *(layout.TimeSeriesView(origin=f"/{name}", name=name) for name in series),
        )
        views = [layout.Spatial3DView(origin=f"/{name}", name=name) for name in spaces]
        whole = layout.Horizontal(layout.Tabs(*views), beside, column_shares=[2, 1])
        self._stream.send_blueprint(layout.Blueprint(whole, collapse_panels=True))

    def set_time(self, timeline: str, number: int) -> None:
        """Set the point on a timeline at which later entries are logged."""
        self._stream.set_time(timeline, sequence=number)

    def log(self, path: str, content: Any, *, static: bool = False) -> None:
        """Log a component of rerun."""
        self._stream.log(path, content, static=static)

    def log_scene(self, scene: Scene | None) -> None:
        """Log a label, if there is one."""
        if scene is not None:
            text = f"{scene.label}, probability {scene.probability:.2f}"
            self.log("scene", self.rr.TextLog(text))

    def log_candidate(self, candidate: Candidate) -> None:
        """Log the decision about a pair of keyframes that may close a loop, with its reason."""
        if candidate.kind == EdgeKind.LOOP:
            text = f"{candidate.query_id} with {candidate.match_id}: {candidate.decision}"
            reason = f": {candidate.reason}" if candidate.reason else ""
            level = "INFO" if candidate.decision == Decision.ACCEPTED else "DEBUG"
            self.log("loops", self.rr.TextLog(text + reason, level=level))


class MapSpace:
    """One space of a recording: keyframes whose poses in the map are comparable."""

    def __init__(self, recording: RerunRecording, root: str = "map") -> None:
        self._recording, self._rr, self.root = recording, recording.rr, root
        self._positions: dict[int, Array] = {}
        self._voxels: set[int] = set()
        self.log("", self._rr.ViewCoordinates.RDF, static=True)

    def log(self, path: str, content: Any, *, static: bool = False) -> None:
        """Log a component of rerun in this space."""
        self._recording.log(f"{self.root}/{path}".rstrip("/"), content, static=static)

    def show_camera(self, T_map_camera: Pose) -> None:
        """Move the camera."""
        R, t = T_map_camera[:3, :3], T_map_camera[:3, 3]
        self.log("camera", self._rr.Transform3D(translation=t, mat3x3=R))

    def show_path(
        self, name: str, number: int, positions_map: Iterable[Array], *, static: bool = False
    ) -> None:
        """Show the way (N, 3) to a keyframe: the ``path``, ``odometry``, or as ``corrected``."""
        strip = self._rr.LineStrips3D([list(positions_map)], colors=[COLORS[name]])
        self.log(f"{name}/{number}", strip, static=static)

    def show_positions(self, positions_map: Array, ids: Sequence[int], component: int) -> None:
        """Show where keyframes (K, 3) are, at all times, in the colour of their component."""
        self._positions.update(zip(ids, positions_map, strict=True))
        points = self._rr.Points3D(
            positions_map,
            radii=0.03,
            colors=[_rgb(component * GOLDEN_RATIO % 1.0)],
            labels=[f"keyframe {k}, component {component}" for k in ids],
            show_labels=False,
        )
        self.log("keyframes", points, static=True)

    def show_room(self, room: MapRoom) -> None:
        """Show the box around the keyframes of a room, at all times."""
        box = self._rr.Boxes3D(
            mins=[room.low_m],
            sizes=[np.subtract(room.high_m, room.low_m)],
            labels=[f"{room.label} {room.id}, probability {room.probability:.2f}"],
            colors=[_color(room.label)],
        )
        self.log(f"rooms/{room.id}", box, static=True)

    def show_keyframe(self, keyframe_id: int, T_map_camera: Pose, label: str | None) -> None:
        """Show where a keyframe is as it comes, in the colour of its label."""
        self._positions[keyframe_id] = T_map_camera[:3, 3]
        point = self._rr.Points3D(
            [T_map_camera[:3, 3]],
            radii=0.03,
            colors=[_color(label)],
            labels=[f"keyframe {keyframe_id}, {label or 'no label'}"],
            show_labels=False,
        )
        self.log(f"keyframes/{keyframe_id}", point)

    def show_frame(
        self, keyframe_id: int, frame: DepthFrame, T_map_camera: Pose, label: str | None, *,
        stride: int = 1,
    ) -> None:  # fmt: skip
        """Show a keyframe's depth, every ``stride``-th pixel, and points in its label's colour."""
        camera = frame.intrinsics
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, stride]])
        depth_mm = np.rint(1e3 * frame.depth_in_range_m(stride)).clip(max=65535).astype(np.uint16)
        size = depth_mm.shape[::-1]
        self.log("camera/depth", self._rr.Pinhole(image_from_camera=K / stride, resolution=size))
        self.log("camera/depth", self._rr.DepthImage(depth_mm, meter=1e3))
        points = self._new(se3.transform(T_map_camera, view_points(frame).astype(np.float64)))
        cloud = self._rr.Points3D(
            points.astype(np.float32), colors=[_color(label)], radii=VOXEL_SIZE_M / 2
        )
        self.log(f"points/{keyframe_id}", cloud)

    def show_loop(self, loop: Loop) -> None:
        """Show a loop that was accepted, if both of its keyframes are in this space."""
        if loop.kind == EdgeKind.LOOP and (ends := self._ends(loop)):
            strip = self._rr.LineStrips3D([ends], colors=[COLORS["loop"]])
            self.log(f"loops/{loop.query_id}-{loop.match_id}", strip)

    def show_refused(self, candidates: Iterable[Candidate]) -> None:
        """Show which pairs of the newest keyframe were no loops, and why; earlier ones vanish."""
        shown = [
            (ends, candidate)
            for candidate in candidates
            if candidate.kind == EdgeKind.LOOP
            and candidate.decision in (Decision.REJECTED, Decision.HELD)
            and (ends := self._ends(candidate))
        ]
        strips = self._rr.LineStrips3D(
            [ends for ends, _ in shown],
            colors=[COLORS[candidate.decision] for _, candidate in shown],
            labels=[f"{candidate.decision}: {candidate.reason}" for _, candidate in shown],
            show_labels=False,
        )
        self.log("refused", strips)

    def _new(self, points_map: Array) -> Array:
        """Return the points (N, 3) in voxels where no point is shown yet, one for each."""
        cells = np.floor(points_map / VOXEL_SIZE_M).astype(np.int64)
        keys, first = np.unique(cells @ VOXEL_KEYS, return_index=True)
        is_new = [key not in self._voxels for key in keys.tolist()]
        self._voxels.update(keys.tolist())
        return points_map[first[is_new]]

    def _ends(self, pair: Loop | Candidate) -> list[Array]:
        """Return the positions of two keyframes; none unless both are known."""
        ends = [self._positions.get(k) for k in (pair.query_id, pair.match_id)]
        known = [end for end in ends if end is not None]
        return known if len(known) == 2 else []


def _import_rerun() -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise PluginError(
            "found no rerun, expected it installed: pip install 'slam-bof[view]'"
        ) from error
    module: ModuleType = rerun
    return module


def _can_show() -> bool:
    """Whether a viewer can be opened, or one already listens, perhaps of another machine."""
    if sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return True
    with socket.socket() as viewer:
        return viewer.connect_ex(("127.0.0.1", VIEWER_PORT)) == 0


def _color(label: str | None) -> tuple[int, ...]:
    """Return the colour of a label, always the same one; grey without a label."""
    if label is None:
        return 150, 150, 150
    return _rgb(zlib.crc32(label.encode()) % 360 / 360)


def _rgb(hue: float) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in colorsys.hsv_to_rgb(hue, 0.6, 0.85))
