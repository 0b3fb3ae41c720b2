"""Export of a saved map to the file formats of other programs."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import registry
from slam_bof.errors import MapError
from slam_bof.geometry import (
    GraphEdge,
    loop_information,
    se3,
    step_sigmas,
    write_g2o,
    write_kitti,
    write_tum,
)
from slam_bof.maps.occupancy_grid import (
    OccupancyGridParams,
    build_occupancy_grid,
    write_occupancy_grid,
)
from slam_bof.maps.point_cloud import write_keyframe_cloud
from slam_bof.slam import FrameHistory, config as configs
from slam_bof.store import MapStore, choose_component, query_keyframes
from slam_bof.types import DepthFrame, Keyframe, Trajectory

__all__ = ["FORMATS", "Format", "export_map", "interrupted", "session_trajectory"]

Format = Literal["tum", "kitti", "csv", "g2o", "ply", "occupancy"]
FORMATS: tuple[Format, ...] = ("tum", "kitti", "csv", "g2o", "ply", "occupancy")

DEFAULT_STEP_SIGMA, DEFAULT_LOOP_SIGMA = 0.05, 0.01
"""Standard deviations in rad and m, for back-ends that have no such parameters."""


def export_map(
    store: MapStore,
    path: Path,
    format_: Format,
    *,
    session: int | None = None,
    component: int | None = None,
    all_frames: bool = False,
    voxel_size_m: float = 0.02,
    z_up: bool = False,
    occupancy: OccupancyGridParams | None = None,
) -> int:
    """Export a map to a file.

    Parameters
    ----------
    store, path, format_
        The map, the file to write, and its content: poses of the keyframes (``tum``, ``kitti``),
        poses and labels (``csv``), the pose graph (``g2o``), a point cloud (``ply``), or an
        occupancy grid for ROS's map_server (``occupancy``: YAML, with a PNG beside it).
    session
        Export only the keyframes of this session; a pose graph always has all.
    component
        Export this component of the pose graph; by default the largest of the session, with a
        warning if there are others. Poses of different components are not comparable.
    all_frames
        With ``tum`` or ``kitti``: every frame of the session, not only its keyframes. ``session``
        may be left out if the map has only one.
    voxel_size_m
        With ``ply``: side of the voxels; one point is kept in each.
    z_up
        With ``ply``: in the plan frame of the occupancy grid (z up, 0 on the floor) instead of the
        frame of the map.
    occupancy
        With ``occupancy``: parameters of the grid.

    Returns
    -------
    int
        Number of poses, rows, keyframes or points written.

    Raises
    ------
    MapError
        If the map is not finished, there is no such session or component, the time stamps of
        several sessions do not increase, or depth images are needed and the map has none.
    """
    with store.snapshot():
        keyframes, poses = store.keyframes(), store.map_poses()
        n_sessions = len(store.sessions())
    if session is not None and session >= n_sessions:
        raise MapError(f"{store.path}: found no session {session}, expected 0 to {n_sessions - 1}")
    inside = choose_component(store, component, session=session)
    own = np.flatnonzero(inside).tolist()
    if format_ == "csv":
        return _write_csv(store, path, set(own))
    if format_ in ("tum", "kitti"):
        return _write_poses(store, path, format_, own, session, all_frames=all_frames)
    if not np.isfinite(poses).all():
        raise interrupted(store)
    if format_ == "g2o":
        edges = (e for e in _graph_edges(store, keyframes) if inside[e.a])
        write_g2o(path, ((k, poses[k]) for k in own), edges)
        return len(own)
    views = _views(store, own)
    if format_ == "ply":
        return write_keyframe_cloud(path, views, poses[own], voxel_size_m=voxel_size_m, z_up=z_up)
    write_occupancy_grid(path, build_occupancy_grid(views, poses[own], occupancy))
    return len(own)


def session_trajectory(store: MapStore, session: int) -> Trajectory:
    """Return T_map_camera of every frame of a session, at the map's present poses."""
    return _session_frames(store, session)[1]


def _session_frames(store: MapStore, session: int) -> tuple[NDArray[np.int64], Trajectory]:
    """Return the segments (N,) and the trajectory of every frame of a session."""
    own = [k for k in store.keyframes() if k.session == session]
    poses = store.map_poses()[[k.id for k in own]]
    history = FrameHistory(store.frames(session))
    segments = np.array([frame.segment for frame in history.frames], dtype=np.int64)
    return segments, history.trajectory(own, poses)


def _write_poses(
    store: MapStore,
    path: Path,
    format_: str,
    ids: list[int],
    session: int | None,
    *,
    all_frames: bool,
) -> int:
    keyframes, poses = store.keyframes(), store.map_poses()
    if ids and not np.isfinite(poses[ids]).any():
        raise interrupted(store)
    several = session is None and len(store.sessions()) > 1
    if all_frames and not several:
        segments, trajectory = _session_frames(store, session or 0)
        if len(ids) < sum(k.session == (session or 0) for k in keyframes):
            inside = np.isin(segments, [keyframes[k].segment for k in ids])
            trajectory = Trajectory(trajectory.stamps_s[inside], trajectory.poses[inside])
    else:
        stamps_s = np.array([keyframes[k].stamp_s for k in ids])
        trajectory = Trajectory(stamps_s, poses[ids].reshape(-1, 4, 4))
    if several and (all_frames or (format_ == "tum" and (np.diff(trajectory.stamps_s) <= 0).any())):
        raise MapError(
            f"{store.path}: found {len(store.sessions())} sessions, whose time stamps overlap, "
            "expected a choice of one: --session"
        )
    known = np.isfinite(trajectory.poses).all(axis=(1, 2))
    trajectory = Trajectory(trajectory.stamps_s[known], trajectory.poses[known])
    (write_tum if format_ == "tum" else write_kitti)(path, trajectory)
    return len(trajectory)


def _graph_edges(store: MapStore, keyframes: Sequence[Keyframe]) -> Iterator[GraphEdge]:
    """Yield the edges of the pose graph, weighted as the back-end of the newest session does."""
    backend = configs.parse_saved(store.sessions()[-1].config, str(store.path)).backend
    params = registry.check_options("backends", backend.name, backend.options)
    sigmas = step_sigmas(
        getattr(params, "odometry_sigma_rad", DEFAULT_STEP_SIGMA),
        getattr(params, "odometry_sigma_m", DEFAULT_STEP_SIGMA),
    )
    loop_sigma = getattr(params, "loop_sigma", DEFAULT_LOOP_SIGMA)
    for before, after in itertools.pairwise(keyframes):
        if before.segment == after.segment:
            T_before_after = se3.inverse(before.T_odom_camera) @ after.T_odom_camera
            yield GraphEdge(before.id, after.id, T_before_after, np.diag(sigmas**-2.0))
    for loop in store.loops():
        information = loop_information(loop.information, loop_sigma)
        yield GraphEdge(loop.match_id, loop.query_id, loop.T_match_query, information)


def interrupted(store: MapStore) -> MapError:
    """Return the error that a map is not finished."""
    return MapError(
        f"{store.path}: found an interrupted run without optimised poses, expected a finished "
        f"one: resume it, or slam-bof map finish {store.path}"
    )


def _views(store: MapStore, ids: list[int]) -> Iterator[DepthFrame]:
    for id_ in ids:
        frame = store.view(id_)
        if frame is None:
            raise MapError(
                f"{store.path}: found no depth image of keyframe {id_}, expected one: maps made "
                "before version 4 have none"
            )
        yield frame


def _write_csv(store: MapStore, path: Path, ids: set[int]) -> int:
    records = [record for record in query_keyframes(store) if record.id in ids]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        head = ("id", "frame_index", "stamp_s", "scene", "probability")
        pose = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
        table.writerow((*head, *pose, "smoothed", "smoothed_probability", "region", "component"))
        for r in records:
            head_values = (r.id, r.frame_index, r.stamp_s, r.scene, r.scene_probability)
            tail_values = (r.smoothed, r.smoothed_probability, r.region, r.component)
            table.writerow((*head_values, *r.translation_m, *r.quaternion_xyzw, *tail_values))
    return len(records)
