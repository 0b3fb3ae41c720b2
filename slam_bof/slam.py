"""The plug-in: two calls beside any odometry."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof import model as models
from slam_bof import registry, se3
from slam_bof.clouds import CloudCamera
from slam_bof.config import Config, load, preset
from slam_bof.covisibility import CovisibilityParams, choose_covisible, view_overlap
from slam_bof.keyframes import KeyframeSelector
from slam_bof.loops import LoopCounts, LoopDetector
from slam_bof.model import Model
from slam_bof.native import one_blas_thread
from slam_bof.parts import MapParts
from slam_bof.points import PointParams, points_camera
from slam_bof.ports import Backend
from slam_bof.scene_filter import SceneFilter, SceneFilterParams
from slam_bof.timing import StageClock
from slam_bof.tracking import Track, Tracker
from slam_bof.trajectory import spread_correction
from slam_bof.types import (
    Array,
    Candidate,
    DepthFrame,
    Intrinsics,
    Keyframe,
    Loop,
    Pose,
    Step,
    Trajectory,
)
from slam_bof.verification import LoopVerification

__all__ = ["LoopCloser"]

N_OVERLAP_POINTS = 200
LOST = -1
"""In place of a segment, of frames while odometry was lost."""


class LoopCloser:
    """Loop closing, map correction and scene labels beside an odometry of your own.

    >>> closer = LoopCloser.from_preset("indoor")  # doctest: +SKIP
    >>> for frame, T_odom_camera in my_odometry:  # doctest: +SKIP
    ...     step = closer.process(frame, T_odom_camera)
    ...     T_map_camera = step.T_map_odom @ T_odom_camera
    >>> trajectory = closer.finish()  # doctest: +SKIP
    """

    def __init__(
        self,
        *,
        model: Model,
        tracker: Tracker,
        selector: KeyframeSelector,
        detector: LoopDetector,
        labels: SceneFilterParams,
        covisibility: CovisibilityParams,
        cloud: PointParams,
        gravity_odom: ArrayLike,
        verification: LoopVerification,
        backend: Backend,
        clock: StageClock | None = None,
    ) -> None:
        self.keyframes: list[Keyframe] = []
        self.loops: list[Loop] = []
        self.loops_left_out: list[Loop] = []
        self.backend = backend
        self._describer = model.describer()
        self._labeller = model.labeller()
        self._scene_filter = SceneFilter(labels)
        self._tracker = tracker
        self._selector = selector
        self._detector = detector
        self._covisibility = covisibility
        self._cloud = cloud
        self._gravity_odom = np.asarray(gravity_odom, dtype=np.float64)
        self._verification = verification
        self._clock = clock or StageClock()
        self._added: list[Loop] = []
        self._parts = MapParts()
        self._camera: Intrinsics | None = None
        self._cloud_camera = CloudCamera(gravity_odom)
        self._T_view_camera: dict[int, Pose] = {}
        self._stamps_s: list[float] = []
        self._T_odom_camera: list[Pose] = []
        self._segments: list[int] = []
        self._T_map_track: Pose = np.eye(4)

    @property
    def loop_counts(self) -> LoopCounts:
        """Keyframes so far by how far their search for a loop came."""
        return self._detector.counts

    @classmethod
    def from_preset(cls, name: str = "indoor") -> Self:
        """Build one from a preset by name: ``indoor`` or ``paper``."""
        return cls.from_config(preset(name))

    @classmethod
    def from_config(cls, config: Config | str | Path, *, clock: StageClock | None = None) -> Self:
        """Build one from a configuration or its YAML file."""
        if not isinstance(config, Config):
            config = load(Path(config))
        model = models.load_default() if config.model == "default" else models.load(config.model)
        detector = LoopDetector(
            config.loops,
            model.vocabulary.n_words,
            gravity_odom=config.gravity_odom,
            seed=config.seed,
        )
        return cls(
            model=model,
            tracker=Tracker(config.tracking, seed=config.seed),
            selector=KeyframeSelector(config.keyframes),
            detector=detector,
            labels=config.labels,
            covisibility=config.covisibility,
            cloud=config.cloud,
            gravity_odom=config.gravity_odom,
            verification=LoopVerification(
                registry.build("verifiers", config.verifier.name, config.verifier.options),
                config.verification,
                compare=detector.compare,
                seed=config.seed,
            ),
            backend=registry.build("backends", config.backend.name, config.backend.options),
            clock=clock,
        )

    @one_blas_thread()
    def process(self, frame: DepthFrame, T_odom_camera: Pose) -> Step:
        """Take a frame and its odometry pose (4, 4); answer with the map's correction.

        Raises
        ------
        ValueError
            If stamps do not grow, the frame is of another camera than those before, or the pose is
            not finite or no rotation and translation; it is not taken then, and others may follow.
        """
        frame_index = len(self._stamps_s)
        last_s = self._stamps_s[-1] if self._stamps_s else -np.inf
        if not last_s < frame.stamp_s < np.inf:
            raise ValueError(f"stamps must grow, got {frame.stamp_s} s after {last_s} s")
        camera = self._camera or frame.intrinsics
        if frame.intrinsics != camera:
            raise ValueError(f"frames must all be of {camera}, got one of {frame.intrinsics}")
        T_odom_camera = np.asarray(T_odom_camera, dtype=np.float64)
        try:
            se3.check_rigid(T_odom_camera)
        except ValueError as error:
            place = f"T_odom_camera of frame {frame_index}, at {frame.stamp_s} s"
            raise ValueError(f"{place}: {error}") from None
        self._camera = camera
        with self._clock.stage("track"):
            track = self._tracker.track(frame, T_odom_camera)
        self._stamps_s.append(frame.stamp_s)
        self._T_odom_camera.append(track.T_odom_camera)
        self._segments.append(LOST if track.is_lost else track.segment)
        if self._begins_segment(track):
            self._selector.reset()
            self._segments[-2] = track.segment  # whose agreement showed that the track is found
        if not track.is_lost and self._selector.select(
            frame_index, track.T_odom_camera, seen=track.seen
        ):
            self._tracker.keep()
            step = self._add_keyframe(frame_index, frame, track)
        else:
            scene = self.keyframes[-1].scene if self.keyframes else None
            step = Step(None, scene, (), (), np.eye(4), is_lost=track.is_lost)
        T_map_camera = self._T_map_track @ track.T_odom_camera
        return replace(step, T_map_odom=T_map_camera @ se3.inverse(T_odom_camera))

    def process_points(self, stamp_s: float, points_camera: Array, T_odom_camera: Pose) -> Step:
        """Take a point cloud where there is no depth image; answer as ``process`` does.

        Of a depth camera's cloud its image is made again. One from all around, as a LiDAR makes
        it, is looked at in one direction of the odometry's frame: the first sensor's forward.
        ``step.keyframe`` and ``step.loops`` are of that view. The first cloud of 100 points or
        more tells which kind of sensor it is; see ``clouds``.

        Parameters
        ----------
        stamp_s
            Time in seconds, on any clock that grows.
        points_camera
            (N, 3) in metres, x right, y down, z forward; what is not finite is dropped.
        T_odom_camera
            (4, 4) the sensor's pose.

        Raises
        ------
        ValueError
            As ``process``, or if the points are not (N, 3).
        """
        T_odom_camera = np.asarray(T_odom_camera, dtype=np.float64)
        is_settled = self._camera is not None
        frame, T_camera_view = self._cloud_camera.look(stamp_s, points_camera, T_odom_camera)
        step = self.process(frame, T_odom_camera @ T_camera_view)
        self._T_view_camera[len(self._stamps_s) - 1] = se3.inverse(T_camera_view)
        if not is_settled and not frame.depth.any():
            self._camera = None  # nothing seen: whatever camera comes next is the first
        return step

    def finish(self) -> Trajectory:
        """Optimise the whole graph; return ``T_map_camera`` of every frame processed.

        Where nothing was ever seen there is no keyframe, and the map is the odometry.
        Loops that contradict the rest move from ``loops`` to ``loops_left_out``.
        """
        with self._clock.stage("optimize"):
            if self._added:
                kept = self.backend.optimize() >= 0.5
                self.loops = list(itertools.compress(self._added, kept))
                self.loops_left_out = list(itertools.compress(self._added, ~kept))
        stamps_s = np.array(self._stamps_s)
        T_odom_camera = np.array(self._T_odom_camera).reshape(-1, 4, 4)
        T_view_camera = np.tile(np.eye(4), (len(stamps_s), 1, 1))
        for frame_index, T in self._T_view_camera.items():
            T_view_camera[frame_index] = T
        if not self.keyframes:
            return Trajectory(stamps_s, T_odom_camera @ T_view_camera)
        frame_indices = np.array([k.frame_index for k in self.keyframes])
        poses = spread_correction(
            T_odom_camera,
            stamps_s,
            frame_indices,
            self.backend.poses(),
            np.array(self._segments),
        )
        return Trajectory(stamps_s, poses @ T_view_camera)

    def _begins_segment(self, track: Track) -> bool:
        """Tell whether the track is found anew; the first keyframe begins nothing anew."""
        return (
            not track.is_lost
            and len(self.keyframes) > 0
            and self.keyframes[-1].segment != track.segment
        )

    @property
    def n_parts(self) -> int:
        """Of how many parts, which no loop has joined, the map is."""
        return len(self._parts)

    @property
    def parts(self) -> NDArray[np.intp]:
        """The part of the map (K,) that each keyframe is in."""
        return self._parts.of_keyframes()

    @property
    def n_odometry_lost(self) -> int:
        """How often the odometry was lost so far."""
        return self._tracker.n_lost

    @property
    def n_frames_lost(self) -> int:
        """Of how many frames so far it is not known where the camera was."""
        return self._segments.count(LOST)

    def _add_keyframe(self, frame_index: int, frame: DepthFrame, track: Track) -> Step:
        T_odom_camera = track.T_odom_camera
        with self._clock.stage("describe"):
            gravity_camera = T_odom_camera[:3, :3].T @ self._gravity_odom
            bag = self._describer.describe(frame, gravity_camera=gravity_camera)
            scene = smoothed = None
            if self._labeller is not None:
                scene = self._labeller.label(frame, gravity_camera=gravity_camera, bag=bag)
                smoothed = self._scene_filter.update(
                    scene, frame.stamp_s, T_odom_camera[:3, 3], segment=track.segment
                )
        where = (len(self.keyframes), frame_index, frame.stamp_s, T_odom_camera)
        keyframe = Keyframe(*where, bag, scene, track.segment, smoothed)
        self.keyframes.append(keyframe)
        with self._clock.stage("query"):
            found = self._detector.find(keyframe, frame)
        self.backend.add_keyframe(keyframe)
        self._parts.add(keyframe.segment)
        with self._clock.stage("verify"):
            points = points_camera(frame, self._cloud)
            proposed = {c.match_id for c in found.candidates if c.decision != "rejected"}
            T_map_camera = self.backend.poses()
            candidates = found.candidates + self._find_covisible(
                keyframe, points, T_map_camera, proposed
            )
            self._verification.add(frame, points)
            candidates, loops = self._verification.verify(
                candidates,
                T_map_camera,
                parts=self._parts.of_keyframes(),
                guesses=found.guesses,
            )
        self._detector.note(loops)
        self.loops.extend(loops)
        self._added.extend(loops)
        with self._clock.stage("optimize"):
            for loop in loops:
                self._join(loop)
                self.backend.add_loop(loop)
            self.backend.update()
            self._T_map_track = self.backend.poses()[-1] @ se3.inverse(T_odom_camera)
        return Step(keyframe, scene, tuple(loops), tuple(candidates), np.eye(4))

    def _join(self, loop: Loop) -> None:
        """Where the loop is between two parts of the map, carry the younger to the older."""
        parts = self._parts.of_keyframes()
        match, query = parts[loop.match_id], parts[loop.query_id]
        if match == query:
            return
        T_map_camera = self.backend.poses()
        T_map_query = T_map_camera[loop.match_id] @ loop.T_match_query
        T = T_map_query @ se3.inverse(T_map_camera[loop.query_id])
        younger, T = (query, T) if query > match else (match, se3.inverse(T))
        self.backend.move(np.flatnonzero(parts == younger), T)
        self._parts.join(loop.match_id, loop.query_id)

    def _find_covisible(
        self, keyframe: Keyframe, points: Array, T_map_camera: Array, found: set[int]
    ) -> list[Candidate]:
        """Return those keyframes, but for ``found``, that by the map see what this one sees."""
        p = self._covisibility
        assert self._camera is not None
        every = max(1, len(points) // N_OVERLAP_POINTS)
        overlaps = view_overlap(
            points[::every], T_map_camera[-1], T_map_camera[:-1], self._camera, p.max_range_m
        )
        parts = self._parts.of_keyframes()
        overlaps[parts[:-1] != parts[-1]] = 0.0
        min_age_s = self._detector.params.min_age_s
        return [
            Candidate(
                keyframe.id,
                match_id,
                "proximity",
                "loop"
                if keyframe.stamp_s - self.keyframes[match_id].stamp_s >= min_age_s
                else "covisibility",
            )
            for match_id in choose_covisible(overlaps, p)
            if match_id not in found
        ]
