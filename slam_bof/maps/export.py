"""A saved map written for other programs."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from slam_bof.errors import MapError
from slam_bof.geometry import write_kitti, write_tum
from slam_bof.maps.g2o import write_g2o
from slam_bof.maps.occupancy_grid import OccupancyParams, make_grid, write_grid
from slam_bof.maps.point_cloud import write_views
from slam_bof.slam import History, config as configs
from slam_bof.store import MapStore, query_keyframes
from slam_bof.types import DepthFrame, Trajectory

__all__ = ["FORMATS", "Format", "export_map", "session_trajectory"]

Format = Literal["tum", "kitti", "csv", "g2o", "ply", "occupancy"]
FORMATS: tuple[Format, ...] = ("tum", "kitti", "csv", "g2o", "ply", "occupancy")


def export_map(
    store: MapStore,
    path: Path,
    format_: Format,
    *,
    session: int | None = None,
    all_frames: bool = False,
    voxel_size_m: float = 0.02,
    occupancy: OccupancyParams | None = None,
) -> int:
    """Write a map; return how many poses (tum, kitti), rows, keyframes or points that are.

    Parameters
    ----------
    store, path, format_
        The map, the file, and what it is: poses of the keyframes (``tum``, ``kitti``), these with
        their labels (``csv``), the pose graph (``g2o``), a cloud (``ply``), or a plan of ROS's
        map_server (``occupancy``, YAML, with a PNG beside it).
    session
        Only its keyframes; a graph is of all.
    all_frames
        Of poses: every frame of the session, not only keyframes; of the only one without a number.
    voxel_size_m, occupancy
        Of the cloud, and of the plan.

    Raises
    ------
    MapError
        If the map is not finished, there is no such session, stamps of several do not grow, or
        it has no depth images where these are asked for.
    """
    keyframes, poses = store.keyframes(), store.map_poses()
    if session is not None and session not in {s.id for s in store.sessions()}:
        raise MapError(
            f"{store.path}: found no session {session}, expected one of {len(store.sessions())}"
        )
    own = [k.id for k in keyframes if session in (None, k.session)]
    if format_ == "csv":
        return _write_csv(store, path, set(own))
    if format_ in ("tum", "kitti"):
        return _write_poses(store, path, format_, own, session, all_frames=all_frames)
    if not np.isfinite(poses).all():
        raise _interrupted(store)
    if format_ == "g2o":
        options = configs.parse(store.sessions()[-1].config, str(store.path)).backend.options
        sigmas = {
            name: float(options.get(name, 0.05))
            for name in ("odometry_sigma_rad", "odometry_sigma_m")
        }
        write_g2o(path, keyframes, poses, store.loops(), **sigmas)
        return len(keyframes)
    views = _views(store, own)
    if format_ == "ply":
        return write_views(path, views, poses[own], voxel_size_m=voxel_size_m)
    write_grid(path, make_grid(views, poses[own], occupancy))
    return len(own)


def session_trajectory(store: MapStore, session: int) -> Trajectory:
    """Return T_map_camera of every frame of a session, as the map has them now."""
    own = [k for k in store.keyframes() if k.session == session]
    poses = store.map_poses()[[k.id for k in own]]
    return History(store.frames(session)).trajectory(own, poses)


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
        raise _interrupted(store)
    several = session is None and len(store.sessions()) > 1
    if all_frames and not several:
        trajectory = session_trajectory(store, session or 0)
    else:
        stamps_s = np.array([keyframes[k].stamp_s for k in ids])
        trajectory = Trajectory(stamps_s, poses[ids].reshape(-1, 4, 4))
    if several and (all_frames or (format_ == "tum" and (np.diff(trajectory.stamps_s) <= 0).any())):
        raise MapError(
            f"{store.path}: found {len(store.sessions())} sessions, each with a time of its own, "
            "expected one of them: --session"
        )
    known = np.isfinite(trajectory.poses).all(axis=(1, 2))
    trajectory = Trajectory(trajectory.stamps_s[known], trajectory.poses[known])
    (write_tum if format_ == "tum" else write_kitti)(path, trajectory)
    return len(trajectory)


def _interrupted(store: MapStore) -> MapError:
    return MapError(
        f"{store.path}: found poses of an interrupted run, expected a finished one: resume it"
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
        names = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
        smoothed = ("smoothed", "smoothed_probability", "region")
        own = ("id", "frame_index", "stamp_s", "scene", "probability")
        table.writerow((*own, *names, *smoothed))
        for r in records:
            own_label = (r.id, r.frame_index, r.stamp_s, r.scene, r.scene_probability)
            around = (r.smoothed, r.smoothed_probability, r.region)
            table.writerow((*own_label, *r.translation_m, *r.quaternion_xyzw, *around))
    return len(records)
