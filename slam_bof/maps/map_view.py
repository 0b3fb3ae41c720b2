"""A saved map in the viewer of rerun, or in a file for it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from slam_bof.errors import MapError
from slam_bof.geometry import se3, view_stride
from slam_bof.maps.export import interrupted
from slam_bof.slam import FrameHistory
from slam_bof.store import MapStore, components_of, largest_component, query_keyframes
from slam_bof.types import Array, Candidate, EdgeKind, Loop
from slam_bof.visualization import MapSpace, RerunRecording

__all__ = ["show_finished_map", "show_map"]


def show_map(store: MapStore, target: str) -> int:
    """Show a finished map; return the number of its keyframes.

    The timeline ``keyframe`` has each keyframe's depth image, pose and labels, the points of the
    map up to it in the colours of the rooms, the path with and without loops, loops, and every
    pair that was considered with the reason of the decision. The largest component is in the space
    ``map``, and each other one in a space of its own, because their poses are not comparable.

    Parameters
    ----------
    store
        The map.
    target
        ``live``, or the .rrd file to write.

    Raises
    ------
    MapError
        If the map is not finished, has no keyframes, or is damaged.
    PluginError
        If rerun is not installed.
    OSError
        If the file cannot be written.
    """
    with store.snapshot():
        view = _MapView(store)
        sequences = ", ".join(session.sequence for session in store.sessions())
        with RerunRecording(sequences, target) as recording:
            view.show(recording)
        return len(view.keyframes)


def show_finished_map(store: MapStore, recording: RerunRecording) -> None:
    """Show the map of a run that was recorded as it went on, at all times: corrected path, rooms.

    Raises
    ------
    MapError
        As ``show_map``.
    """
    with store.snapshot():
        _MapView(store).show_finished(recording)


class _MapView:
    """The contents of a map, by keyframe."""

    def __init__(self, store: MapStore) -> None:
        self._store = store
        self.keyframes, self._poses = store.keyframes(), store.map_poses()
        if not self.keyframes:
            raise MapError(f"{store.path}: found no keyframes, expected at least one")
        if not np.isfinite(self._poses).all():
            raise interrupted(store)
        self._components, self._infos = components_of(store), query_keyframes(store)
        self._rooms = [room for room in store.rooms() if room.keyframe_ids]
        self._room_of = {k: room for room in self._rooms for k in room.keyframe_ids}
        self._pairs: dict[int, list[Candidate]] = defaultdict(list)
        for pair in store.candidates():
            if pair.kind == EdgeKind.LOOP:
                self._pairs[pair.query_id].append(pair)
        self._loops: dict[int, list[Loop]] = defaultdict(list)
        for loop in store.loops():
            self._loops[loop.query_id].append(loop)

    def show(self, recording: RerunRecording) -> None:
        """Show positions and rooms from the start, and all else with its keyframe."""
        spaces = self._spaces(recording)
        largest_first = sorted(spaces.values(), key=lambda space: space.root != "map")
        recording.arrange([space.root for space in largest_first])
        ways = self._ways()
        for keyframe in self.keyframes:
            k = keyframe.id
            space, scene = spaces[int(self._components[k])], keyframe.smoothed or keyframe.scene
            recording.set_time("keyframe", k)
            recording.log_scene(scene)
            recording.log("keyframe", recording.rr.TextDocument(self._page(k), media_type=MARKDOWN))
            space.show_camera(self._poses[k])
            for name, way in ways[k].items():
                space.show_path(name, k, way)
            frame, room = self._store.view(k), self._room_of.get(k)
            if frame is not None:
                label = room.label if room else scene.label if scene else None
                stride = view_stride(frame.intrinsics)
                space.show_frame(k, frame, self._poses[k], label, stride=stride)
            for loop in self._loops[k]:
                space.show_loop(loop)
            for pair in self._pairs[k]:
                recording.log_candidate(pair)
            space.show_refused(self._pairs[k])

    def show_finished(self, recording: RerunRecording) -> None:
        """Show positions, rooms and the corrected path, at all times."""
        spaces = self._spaces(recording)
        for k, way in self._ways().items():
            space = spaces[int(self._components[k])]
            space.show_path("corrected", k, way["path"], static=True)

    def _spaces(self, recording: RerunRecording) -> dict[int, MapSpace]:
        """Return the space of each component, in which its keyframes and rooms are shown."""
        largest = largest_component(self._components)
        spaces = {
            n: MapSpace(recording, "map" if n == largest else f"component_{n}")
            for n in np.unique(self._components).tolist()
        }
        for n, space in spaces.items():
            self._show_plan(space, n)
        return spaces

    def _show_plan(self, space: MapSpace, component: int) -> None:
        """Show where the keyframes of a component are, and its rooms."""
        ids = np.flatnonzero(self._components == component)
        space.show_positions(self._poses[ids, :3, 3], ids.tolist(), component)
        for room in self._rooms:
            if self._components[room.keyframe_ids[0]] == component:
                space.show_room(room)

    def _ways(self) -> dict[int, dict[str, Array]]:
        """Return the way (N, 3) to each keyframe from the one before, on the path and by odometry.

        Odometry starts at the pose that the map has for the first keyframe of each segment.
        """
        ways = {}
        for session in self._store.sessions():
            own = [keyframe for keyframe in self.keyframes if keyframe.session == session.id]
            history = FrameHistory(self._store.frames(session.id))
            path = history.trajectory(own, self._poses[[k.id for k in own]]).poses
            odometry = history.odometry().poses
            segment, last, T_map_odom = None, 0, np.eye(4)
            for keyframe in own:
                at = keyframe.frame_index
                if keyframe.segment != segment:
                    segment, last = keyframe.segment, at
                    T_map_odom = path[at] @ se3.inverse(odometry[at])
                frames = slice(last, at + 1)
                ways[keyframe.id] = {
                    "path": path[frames, :3, 3],
                    "odometry": (T_map_odom @ odometry[frames])[:, :3, 3],
                }
                last = at
        return ways

    def _page(self, k: int) -> str:
        """Return what is known of a keyframe, and the pairs it was considered in, in Markdown."""
        info, room = self._infos[k], self._room_of.get(k)
        sequence = self._store.sessions()[self.keyframes[k].session].sequence
        rows = [
            ("frame", f"{info.frame_index} of {sequence}, {info.stamp_s:.3f} s"),
            ("label", _label(info.smoothed, info.smoothed_probability)),
            ("label of this image alone", _label(info.scene, info.scene_probability)),
            ("room", f"{room.label} {room.id}" if room else "none"),
            ("component", f"{info.component}"),
        ]
        pairs = [
            (f"{c.match_id}", c.source, c.decision, _number(c.overlap), c.reason)
            for c in self._pairs[k]
        ]
        heads = ("pair with", "source", "decision", "overlap", "reason")
        return f"# Keyframe {k}\n\n{_table(('', ''), rows)}\n\n{_table(heads, pairs)}\n"


MARKDOWN = "text/markdown"


def _label(label: str | None, probability: float | None) -> str:
    return "none" if label is None else f"{label}, probability {probability or 0.0:.2f}"


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.2f}"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ("---",) * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
