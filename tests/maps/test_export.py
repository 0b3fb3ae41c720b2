"""A saved map in other programs' formats, read back with their readers."""

from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest
import yaml
from saved_maps import make_keyframe, save

from slam_bof import LoopCloser
from slam_bof.core import import_open3d, registry
from slam_bof.errors import MapError
from slam_bof.geometry import loop_information, read_tum, se3
from slam_bof.maps import OccupancyGridParams, export_map, session_trajectory
from slam_bof.maps.occupancy_grid import FREE, OCCUPIED, UNKNOWN, build_occupancy_grid
from slam_bof.store import MapStore, Session, SessionResult

open3d = import_open3d()

PER_QUATERNION = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
"""GTSAM's reader takes g2o's information about quaternions for that about rotation vectors."""


@pytest.fixture(scope="module")
def turn(look, standpoint):
    """A camera that turns all around in a furnished room, and its poses (N, 4, 4)."""
    poses = []
    down = se3.exp(np.array([-0.4, 0.0, 0.0, 0.0, 0.0, 0.0]))  # by 23 degrees
    for yaw in np.arange(0.0, 2 * np.pi, 0.25):
        c, s = np.cos(yaw), np.sin(yaw)
        pose = np.eye(4)
        pose[:3] = [[s, 0, c, standpoint[0]], [-c, 0, s, standpoint[1]], [0, -1, 0, 1.3]]
        poses.append(pose @ down)
    return [look(pose, index) for index, pose in enumerate(poses)], np.array(poses)


@pytest.fixture(scope="module")
def store(turn, tmp_path_factory):
    """The finished map of the turn."""
    frames, poses = turn
    with MapStore.create(tmp_path_factory.mktemp("maps") / "map.db") as store:
        store.begin_session(Session(0, "7scenes", "room/seq-01"))
        closer = LoopCloser.from_preset("indoor", journal=store.write)
        for frame, T in zip(frames, poses, strict=True):
            closer.process(frame, se3.inverse(poses[0]) @ T)
        closer.finish()
        n = len(closer.map.keyframes)
        result = SessionResult(closer.frames_since_keyframe, closer.map.poses(), [None] * n, [])
        store.finish(0, result)
        yield store


def test_the_pose_graph_is_read_by_gtsam(store, tmp_path):
    n = export_map(store, tmp_path / "graph.g2o", "g2o")
    graph, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    poses, loops = store.map_poses(), store.loops()
    assert values.size() == n == len(poses)
    assert graph.size() == n - 1 + len(loops)
    for id_, T in enumerate(poses):
        np.testing.assert_allclose(values.atPose3(id_).matrix(), T, atol=1e-9)
    edges = [graph.at(k) for k in range(graph.size())]
    by_ends = {tuple(edge.keys()): edge for edge in edges[n - 1 :]}
    for loop in loops:
        edge = by_ends[loop.match_id, loop.query_id]
        np.testing.assert_allclose(edge.measured().matrix(), loop.T_match_query, atol=1e-9)
        information = edge.noiseModel().information() * np.outer(PER_QUATERNION, PER_QUATERNION)
        expected = loop_information(loop.information, 0.01)
        np.testing.assert_allclose(information, expected, rtol=1e-6, atol=1e-3)


def test_the_exported_graph_is_that_of_the_run(store, tmp_path):
    """The back-end and the map have one graph: the same edges with the same weights."""
    backend = registry.build("backends", "gtsam", {})
    for keyframe in store.keyframes():
        backend.add_keyframe(keyframe)
        backend.update()
    for loop in store.loops():
        backend.add_loop(loop)
    backend.write_g2o(tmp_path / "run.g2o")
    export_map(store, tmp_path / "map.g2o", "g2o")
    run, exported = (
        [
            line.split()
            for line in (tmp_path / name).read_text().splitlines()
            if line.startswith("EDGE")
        ]
        for name in ("run.g2o", "map.g2o")
    )
    assert [line[:3] for line in run] == [line[:3] for line in exported]
    for ours, theirs in zip(run, exported, strict=True):
        np.testing.assert_allclose(
            np.array(ours[3:], float), np.array(theirs[3:], float), rtol=1e-6, atol=1e-6
        )


def test_the_cloud_is_read_by_open3d(store, turn, tmp_path):
    n = export_map(store, tmp_path / "cloud.ply", "ply", voxel_size_m=0.05)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    points = np.asarray(cloud.points)
    assert len(points) == n > 1000
    assert cloud.has_colors()
    world = se3.transform(turn[1][0], points)
    assert world[:, 2].min() > -0.1  # nothing below the floor
    low, high = (
        np.array(cloud.colors)[world[:, 2].argmin()],
        np.array(cloud.colors)[world[:, 2].argmax()],
    )
    assert low[2] > low[0]
    assert high[0] > high[2]


def test_every_frame_and_every_keyframe(store, tmp_path):
    n = export_map(store, tmp_path / "keyframes.txt", "tum")
    assert n == len(read_tum(tmp_path / "keyframes.txt")) == len(store.keyframes())
    n = export_map(store, tmp_path / "frames.txt", "tum", all_frames=True)
    found = read_tum(tmp_path / "frames.txt")
    assert n == len(found) == len(store.frames(0))
    np.testing.assert_allclose(found.poses, session_trajectory(store, 0).poses, atol=1e-9)
    with pytest.raises(MapError, match="found no session 3, expected 0 to 0"):
        export_map(store, tmp_path / "none.txt", "tum", session=3)


def test_the_plan_is_as_map_server_has_it(store, turn, room, tmp_path):
    export_map(store, tmp_path / "plan.yaml", "occupancy")
    found = yaml.safe_load((tmp_path / "plan.yaml").read_text())
    assert (found["image"], found["resolution"], found["negate"]) == ("plan.png", 0.05, 0)
    cells = cv2.imread(str(tmp_path / "plan.png"), cv2.IMREAD_UNCHANGED)
    assert set(np.unique(cells)) == {FREE, OCCUPIED, UNKNOWN}

    def value(x_m, y_m):
        column = int((x_m - found["origin"][0]) / 0.05)
        row = len(cells) - 1 - int((y_m - found["origin"][1]) / 0.05)
        return cells[row, column]

    assert value(0.0, 0.0) == FREE  # where the camera stands
    assert value(found["origin"][0] + 0.03, found["origin"][1] + 0.03) == UNKNOWN
    T_plan_camera = np.array(found["T_plan_map"]) @ store.map_poses()
    assert all(value(x, y) == FREE for x, y in T_plan_camera[:, :2, 3])
    np.testing.assert_allclose(T_plan_camera[:, 2, 3], 1.3, atol=0.05)  # above the floor


def test_the_plan_agrees_with_the_room(turn, room):
    """What is free in the plan has nothing between knee and head in the room."""
    frames, poses = turn
    grid = build_occupancy_grid(frames, poses, OccupancyGridParams(), gravity_map=(0.0, 0.0, -1.0))
    assert grid.floor_seen
    T_map_plan = se3.inverse(grid.T_plan_map)
    rows, columns = np.indices(grid.cells.shape)
    x = grid.origin_m[0] + (columns + 0.5) * grid.resolution_m
    y = grid.origin_m[1] + (len(grid.cells) - 0.5 - rows) * grid.resolution_m
    plan = np.stack([x, y, np.zeros_like(x), np.ones_like(x)], axis=-1) @ T_map_plan.T
    np.testing.assert_allclose(plan[..., 2], 0.0, atol=0.03)
    low, high = (corner[:2] for corner in room.mesh.bounds())
    inside = ((plan[..., :2] > low) & (plan[..., :2] < high)).all(axis=-1)
    assert inside[grid.cells == FREE].mean() > 0.99
    sides = np.stack([low, high])
    walls = (np.abs(plan[..., None, :2] - sides) < 0.1).any(axis=(-2, -1))
    assert (grid.cells[walls] == OCCUPIED).sum() > 40
    assert (grid.cells == FREE).sum() * grid.resolution_m**2 > 3.0


def test_what_cannot_be_exported_is_named(tmp_path):
    with MapStore.create(tmp_path / "map.db") as store:
        save(store, make_keyframe(0))
        for format_ in ("tum", "g2o", "ply", "occupancy"):
            with pytest.raises(MapError, match="an interrupted run without optimised poses"):
                export_map(store, tmp_path / "out", format_)
    with pytest.raises(MapError, match="found no surface in 0 keyframes"):
        build_occupancy_grid([], np.empty((0, 4, 4)))


def test_sessions_with_a_time_of_their_own_are_exported_one_by_one(tmp_path):
    with MapStore.create(tmp_path / "map.db") as store:
        for id_, session in ((0, 0), (1, 0), (2, 1), (3, 1)):
            keyframe = make_keyframe(id_, session=session)
            save(
                store,
                replace(keyframe, frame_index=id_ % 2, stamp_s=id_ % 2, segment=0),
                n_frames=1,
            )
        for session in (0, 1):
            store.finish(session, SessionResult([], np.tile(np.eye(4), (4, 1, 1)), [None] * 4, []))
        for all_frames in (False, True):
            with pytest.raises(MapError, match="found 2 sessions, whose time stamps overlap"):
                export_map(store, tmp_path / "out", "tum", all_frames=all_frames)
            assert export_map(store, tmp_path / "out", "tum", session=1, all_frames=all_frames) == 2
        assert export_map(store, tmp_path / "out", "kitti") == 4
