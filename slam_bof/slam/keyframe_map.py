"""The keyframes of the map: description, loops and pose graph."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import StageClock, registry
from slam_bof.geometry import (
    PointParams,
    points_camera,
    restore_frame,
    se3,
    view_stride,
)
from slam_bof.loops import (
    LoopCounts,
    LoopVerification,
    MapPoses,
    RankedCandidates,
    Verified,
    find_covisible,
    make_loop_detector,
)
from slam_bof.scenes import model as models
from slam_bof.slam.config import Config
from slam_bof.slam.keyframe_culling import KeyframeCulling
from slam_bof.slam.keyframe_describer import KeyframeDescriber
from slam_bof.slam.map_outline import MapOutline, outline_of
from slam_bof.slam.map_uncertainty import PoseUncertainty
from slam_bof.slam.memory_limit import MemoryLimit
from slam_bof.slam.pose_graph import MapGraph
from slam_bof.types import (
    Array,
    Bag,
    Candidate,
    Decision,
    DepthFrame,
    EdgeKind,
    Keyframe,
    KeyframeRecord,
    Loop,
    Pose,
    SavedConstellation,
)

__all__ = ["KeyframeMap"]

NO_WORDS = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


class KeyframeMap:
    """Stores the keyframes of one or more sessions, and closes loops between them.

    Attributes
    ----------
    keyframes
        All keyframes in the order in which they were added.
    first_keyframe
        Id of the first keyframe of the current session.
    session
        Number of the current session, from 0.
    graph
        The pose graph of the keyframes.
    model_name, model_hash
        The model whose vocabulary describes the keyframes, and its content hash.
    T_map_track
        (4, 4) correction of the track that the newest keyframe belongs to:
        ``T_map_camera = T_map_track @ T_odom_camera``.
    """

    def __init__(self, config: Config, clock: StageClock) -> None:
        model = models.resolve(config.model)
        self.keyframes: list[Keyframe] = []
        self.first_keyframe = 0
        self.session = 0
        self.T_map_track: Pose = np.eye(4)
        self.model_name, self.model_hash = config.model, model.content_hash
        self._config = config
        self._gravity_odom = np.asarray(config.gravity_odom, dtype=np.float64)
        self._describer = KeyframeDescriber(model, config.labels, self._gravity_odom)
        self._detector = make_loop_detector(
            config.loops,
            model.vocabulary.n_words,
            gravity_odom=config.gravity_odom,
            seed=config.seed,
        )
        self._verification = LoopVerification(
            registry.build("verifiers", config.verifier.name, config.verifier.options),
            config.verification,
            compare=self._detector.compare,
            seed=config.seed,
        )
        self.graph = MapGraph(
            registry.build("backends", config.backend.name, config.backend.options),
            is_tracked=config.tracking.enabled,
        )
        consistency = config.verification.consistency
        self._culling = KeyframeCulling(
            config.map,
            window=consistency.window,
            max_distance_m=consistency.max_distance_m,
            max_angle_rad=consistency.max_angle_rad,
        )
        self._can_cull = config.map.cull and config.loops.by == "views" and self.graph.can_cull
        self._memory_limit = MemoryLimit(config.map.max_memory_mb)
        self._clock = clock

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self.keyframes)

    @property
    def of_session(self) -> list[Keyframe]:
        """The keyframes of the current session."""
        return self.keyframes[self.first_keyframe :]

    @property
    def loops(self) -> list[Loop]:
        """The loop and covisibility edges of the pose graph."""
        return self.graph.loops

    @property
    def loops_left_out(self) -> list[Loop]:
        """The edges that ``LoopCloser.finish`` removed because they contradict the others."""
        return self.graph.left_out

    def poses(self) -> Array:
        """Return the pose ``T_map_camera`` (K, 4, 4) of every keyframe."""
        return self.graph.poses()

    def covariances(self) -> Array:
        """Return the covariance (K, 6, 6) of every keyframe; see ``MapUncertainty.covariances``."""
        return self.graph.covariances()

    def uncertainty(self) -> PoseUncertainty:
        """Return how uncertain the pose of the newest keyframe is."""
        return self.graph.uncertainty.newest(
            self.graph.components.in_use(), self.graph.T_map_camera
        )

    def outline(self) -> MapOutline:
        """Return what a picture of the map needs; of a map in the background, in one answer."""
        return outline_of(
            self.keyframes,
            self.poses() if self.keyframes else np.empty((0, 4, 4)),
            self.loops,
            self._config,
            components=self.components,
            anchors=self.anchors,
        )

    @property
    def n_components(self) -> int:
        """The number of connected components of the pose graph."""
        return len(self.graph.components)

    @property
    def components(self) -> NDArray[np.intp]:
        """The component (K,) of each keyframe."""
        return self.graph.components.of_keyframes()

    @property
    def in_use(self) -> NDArray[np.int64]:
        """Ids (n,) of the keyframes that were not culled."""
        return self.graph.in_use

    @property
    def anchors(self) -> NDArray[np.int64]:
        """The id (K,) of each keyframe, or that of its anchor if it was culled."""
        return self.graph.anchors

    @property
    def trusts_odometry(self) -> bool:
        """Whether the odometry of this session is known to be about as precise as alignment."""
        return self.graph.trusts_odometry(self.session)

    @property
    def loop_counts(self) -> LoopCounts:
        """Numbers of keyframes of this session by the stage that their loop search reached."""
        return self._detector.counts

    @property
    def n_global_registrations(self) -> int:
        """Number of pairs in this session that were registered without an initial pose."""
        return self._verification.n_global_registrations

    @property
    def newest_constellation(self) -> SavedConstellation | None:
        """How the newest keyframe was described for the search, None with bags."""
        return self._detector.newest

    def begin_session(self) -> None:
        """Begin a session with another odometry frame. Its clock may restart."""
        self.session += 1
        self.first_keyframe = len(self)
        self._detector.begin_session(self._gravity_odom)
        self._verification.n_global_registrations = 0
        self._describer.begin_session()

    def describe(
        self,
        frame_index: int,
        frame: DepthFrame,
        T_odom_camera: Pose,
        *,
        segment: int,
        step_covariance: Array | None = None,
        T_odom_raw: Pose | None = None,
    ) -> Keyframe:
        """Describe and label a frame as the next keyframe."""
        with self._clock.stage("describe"):
            bag, scene, smoothed = self._describer.describe(frame, T_odom_camera, segment=segment)
        return Keyframe(
            id=len(self),
            frame_index=frame_index,
            stamp_s=frame.stamp_s,
            T_odom_camera=T_odom_camera,
            bag=bag,
            scene=scene,
            segment=segment,
            smoothed=smoothed,
            session=self.session,
            step_covariance=step_covariance,
            T_odom_raw=T_odom_raw,
        )

    def add(self, keyframe: Keyframe, frame: DepthFrame) -> Verified:
        """Add the newest keyframe; return the decisions about its loop candidates."""
        frame = frame.with_sensor(self._config.sensor)
        is_full = self._memory_limit.is_reached()
        self.keyframes.append(keyframe)
        with self._clock.stage("query"):
            if is_full:
                self._detector.remember(keyframe, frame, [])
                found = RankedCandidates()
            else:
                found = self._detector.find(keyframe, frame)
        self.graph.add_keyframe(keyframe)
        with self._clock.stage("verify"):
            points = points_camera(frame, self._cloud_params(frame))
            proposed = {c.match_id for c in found.candidates if c.decision != Decision.REJECTED}
            covisible = [] if is_full else self._find_covisible(frame, points)
            self._verification.add(frame, points)
            candidates = found.candidates + [c for c in covisible if c.match_id not in proposed]
            poses = MapPoses(
                T_map_camera=self.graph.T_map_camera,
                path_m=self.graph.shortest_paths_m() if candidates else np.empty(0),
                components=self.graph.components.in_use(),
            )
            aligned = self._verification.align(candidates, poses.T_map_camera, found.guesses)
            verified = self._verification.decide(candidates, aligned, poses)
        self._add_loops(verified.admitted)
        if is_full:
            self._detector.remove([keyframe.id])
            self._verification.remove([keyframe.id])
        elif self._can_cull:
            self._culling.undecided.append(keyframe.id)
        return verified

    def cull(self) -> tuple[tuple[int, int], ...]:
        """Cull keyframes that show nothing new; return the id of each and of its anchor.

        They leave the search, the stored views and the pose graph; ``poses`` still has them.
        """
        if not self._can_cull:
            return ()
        with self._clock.stage("optimize"):
            anchors = self._culling.choose(self.graph, self._verification.waiting)
            self._remove_culled(anchors)
        return tuple(anchors.items())

    def replay(self, record: KeyframeRecord) -> None:
        """Replay a saved keyframe: restore labels, index and graph without searching again."""
        keyframe = record.keyframe
        frame = restore_frame(record.depth, keyframe.stamp_s).with_sensor(self._config.sensor)
        self._describer.replay(keyframe)
        self.keyframes.append(keyframe)
        self._detector.remember(keyframe, frame, record.candidates, record.constellation)
        self.graph.add_keyframe(keyframe)
        self._verification.add(frame, points_camera(frame, self._cloud_params(frame)))
        loops = [loop for loop in record.measured if loop.kind == EdgeKind.LOOP]
        components = self.graph.components.in_use()
        self._verification.admit(loops, self.graph.T_map_camera, components)
        self._add_loops(record.admitted)
        self._remove_culled(dict(record.culled))

    def state(self) -> dict[str, Any]:
        """Return the state that keyframe records do not contain, as JSON values."""
        return self._detector.state() | {
            "n_global_registrations": self._verification.n_global_registrations,
            "undecided": list(self._culling.undecided),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state of ``state``, after its keyframes were replayed."""
        self._detector.restore(state)
        self._verification.n_global_registrations = state.get("n_global_registrations", 0)
        self._culling.undecided = list(state.get("undecided", ()))

    def _remove_culled(self, anchors: dict[int, int]) -> None:
        if not anchors or not self.graph.can_cull:
            return
        self.graph.cull(anchors, self._config.map.max_edges)
        self._detector.remove(anchors)
        self._verification.remove(anchors)
        self._follow_newest()
        for keyframe_id in anchors:
            self.keyframes[keyframe_id] = replace(self.keyframes[keyframe_id], bag=NO_WORDS)

    def _add_loops(self, loops: Iterable[Loop]) -> None:
        loops = list(loops)
        self._detector.on_loops_accepted(loops)
        with self._clock.stage("optimize"):
            self.graph.add_loops(loops)
            self._follow_newest()

    def _follow_newest(self) -> None:
        """Correct the track by where the map has its newest keyframe."""
        T_odom_camera = self.keyframes[-1].T_odom_camera
        self.T_map_track = self.graph.T_map_camera[-1] @ se3.inverse(T_odom_camera)

    def _cloud_params(self, frame: DepthFrame) -> PointParams:
        """Return the parameters of the point cloud, limited to pixels that a saved map keeps."""
        saved_stride = view_stride(frame.intrinsics)
        cloud = self._config.cloud
        if cloud.stride % saved_stride == 0:
            return cloud
        return cloud.model_copy(update={"stride": saved_stride})

    def _find_covisible(self, frame: DepthFrame, points: Array) -> list[Candidate]:
        """Return pairs of the newest keyframe with others that see the same surfaces."""
        return find_covisible(
            self.keyframes,
            points,
            frame.intrinsics,
            self.graph.T_map_camera,
            self.graph.components.in_use(),
            self._config.covisibility,
            min_age_s=self._config.loops.min_age_s,
        )
