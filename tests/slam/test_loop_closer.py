"""What no end-to-end run shows of the two-call plug-in."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from slam_bof.bof import LayerParams, PlaceParams, descriptors
from slam_bof.errors import ConfigError, FrameError
from slam_bof.geometry import se3
from slam_bof.scenes import TrainingFrame, model as models, train_model
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.config import override


@pytest.fixture
def gravity_model(tmp_path, look):
    """A model whose layers follow gravity, of a few views of a room."""
    params = PlaceParams(layers=LayerParams(n_layers=8, axis="gravity"))
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    poses[:, :3, 3] = [[2.0, 2.0, 1.2 + 0.1 * i] for i in range(4)]
    frames = [look(pose, index) for index, pose in enumerate(poses)]
    down = np.array([0.0, 1.0, 0.0])
    model = train_model(
        [TrainingFrame(frame, gravity_camera=down) for frame in frames],
        params,
        n_words=8,
        trained_on="a room of the tests",
    )
    models.save(model, tmp_path / "gravity.bof")
    return tmp_path / "gravity.bof", params, frames


def test_gravity_follows_the_odometry(gravity_model):
    file, params, (frame, *_) = gravity_model
    tilt = 0.5
    T_odom_camera = np.eye(4)
    T_odom_camera[1:3, 1:3] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    config = override(preset("indoor"), [f"model={file}"])
    step = LoopCloser.from_config(config).process(frame, T_odom_camera)
    model = models.load(file)
    words = model.vocabulary.lookup(
        descriptors(frame, params, gravity_camera=T_odom_camera[:3, :3].T @ [0.0, 1.0, 0.0])
    )
    level = model.describer().words(frame, gravity_camera=np.array([0.0, 1.0, 0.0]))
    expected, otherwise = model.tf_idf.bag(words), model.tf_idf.bag(level)
    assert step.keyframe.bag.words.tolist() == expected.words.tolist()
    assert step.keyframe.bag.words.tolist() != otherwise.words.tolist()


def ahead(standpoint):
    """Return the pose (4, 4) of a level camera that looks along x from a place in a room."""
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[:3, 3] = [*standpoint, 1.3]
    return T


def test_depths_beyond_the_range_of_the_sensor_are_not_used(look, standpoint):
    frame = look(ahead(standpoint), 0)
    limit_m = float(np.median(frame.depth_in_range_m()))
    depths_m = []
    for max_depth_m in (8.0, limit_m):
        records = []
        config = override(preset("indoor"), [f"sensor.max_depth_m={max_depth_m}"])
        LoopCloser.from_config(config, journal=records.append).process(frame, ahead(standpoint))
        depths_m.append(records[0].depth.depth / records[0].depth.per_m)
    assert depths_m[0].max() > limit_m
    np.testing.assert_array_equal(depths_m[1], np.where(depths_m[0] > limit_m, 0.0, depths_m[0]))


@pytest.fixture
def three_rounds(look, standpoint):
    """Three rounds on the spot, 22 frames each, (frame, T_odom_camera)."""
    x, y = standpoint
    yaws = np.tile(np.arange(0.0, 2.2, 0.1), 3)
    c, s, o, i = np.cos(yaws), np.sin(yaws), np.zeros(66), np.ones(66)
    rows = [[s, o, c, x * i], [-c, o, s, y * i], [o, -i, o, 1.3 * i], [o, o, o, i]]
    poses = np.moveaxis(np.array(rows), -1, 0)
    return [
        (replace(look(T, k), stamp_s=k / 10 + 4.0 * (k // 22)), se3.inverse(poses[0]) @ T)
        for k, T in enumerate(poses)
    ]


def match_rounds(three_rounds, *assignments):
    """Return how often keyframes of each round matched which round before."""
    at_once = "verification.consistency.n_required=0"  # loops wait for no other to agree
    options = ["covisibility.max_edges=0", at_once, *assignments]
    closer = LoopCloser.from_config(override(preset("indoor"), options))
    for frame, T_odom_camera in three_rounds:
        closer.process(frame, T_odom_camera)
    rounds = [k.frame_index // 22 for k in closer.map.keyframes]
    return Counter((rounds[loop.query_id], rounds[loop.match_id]) for loop in closer.map.loops)


def test_who_stands_where_another_stood_is_not_searched_for(three_rounds):
    found = match_rounds(three_rounds)
    without = match_rounds(three_rounds, "loops.revisit_distance_m=0")
    assert found[1, 0] == without[1, 0] > 5
    assert without[2, 1] > 5
    assert found[2, 1] < without[2, 1]
    assert found[2, 0] >= without[2, 0]


def test_a_camera_at_rest_costs_nothing(look, standpoint):
    T_world_camera = np.eye(4)
    T_world_camera[:3] = [[0, 0, 1, standpoint[0]], [-1, 0, 0, standpoint[1]], [0, -1, 0, 1.3]]
    closer = LoopCloser.from_preset("indoor")
    for k in range(60):
        closer.process(look(T_world_camera, k), np.eye(4))
    assert len(closer.map.keyframes) == 1
    assert len(closer.map.loops) == 0
    assert np.abs(closer.finish().poses - np.eye(4)).max() < 0.005


def test_a_preset_is_named_where_a_configuration_is_expected(tmp_path):
    (tmp_path / "my.yaml").write_text("keyframes: {policy: every}")
    assert LoopCloser.from_config("paper").config.keyframes.policy == "every"
    assert LoopCloser.from_config(str(tmp_path / "my.yaml")).config.keyframes.policy == "every"
    assert LoopCloser.from_config(tmp_path / "my.yaml").config.keyframes.policy == "every"
    with pytest.raises(ConfigError, match="no preset 'outdoor'"):
        LoopCloser.from_config("outdoor")


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.eye(3), r"found an array \(3, 3\), expected \(6, 6\)"),
        (np.diag([1.0, 1.0, np.nan, 1.0, 1.0, 1.0]), "36 finite numbers"),
        (np.triu(np.ones((6, 6))), "symmetric"),
        (np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0]), "no negative variance"),
    ],
)
def test_what_is_no_covariance_is_refused_and_the_frame_is_ignored(
    look, standpoint, covariance, message
):
    closer = LoopCloser.from_preset()
    frame = look(ahead(standpoint), 0)
    with pytest.raises(FrameError, match=message):
        closer.process(frame, np.eye(4), covariance)
    assert closer.process(frame, np.eye(4), np.zeros(36)).keyframe is not None


def test_the_covariance_of_a_keyframe_adds_up_since_the_one_before(look, standpoint):
    """Translation comes first in the argument, as in nav_msgs/Odometry, and rotation in the map."""
    T_world_first = ahead(standpoint)
    covariance = np.diag([4e-11, 4e-11, 4e-11, 1e-11, 1e-11, 1e-11])
    closer = LoopCloser.from_preset()
    for k in range(12):
        T = se3.exp(np.array([0.0, 0.04 * k, 0.0, 0.0, 0.0, 0.0]))
        step = closer.process(look(T_world_first @ T, k), T, covariance)
    first, second = closer.map.keyframes[:2]
    n_frames = second.frame_index - first.frame_index
    variances = np.diag(second.step_covariance)
    assert step.health == "tracked"
    assert variances[:3] == pytest.approx(n_frames * 1e-11, rel=0.01)
    assert variances[3:] == pytest.approx(n_frames * 4e-11, rel=0.01)
    saved = closer.history.frames[second.frame_index].step_covariance
    assert saved is second.step_covariance


def test_a_frame_has_the_covariance_of_its_pose(look, standpoint):
    T_world_first = ahead(standpoint)
    closer = LoopCloser.from_preset()
    sigmas = []
    for k in range(12):
        T = se3.exp(np.array([0.0, 0.04 * k, 0.0, 0.0, 0.0, 0.0]))
        step = closer.process(look(T_world_first @ T, k), T)
        variances = np.diag(step.covariance)
        assert (variances > 0.0).all()
        sigmas.append(np.sqrt(variances[:3].sum()))
    assert len(closer.map.keyframes) > 2
    assert sigmas[-1] > sigmas[0]  # it grows along the way
    assert sigmas[-1] < 0.2
    away = closer.process(look(T_world_first, 12), T @ se3.pose(np.eye(3), [5.0, 0.0, 0.0]))
    assert not away.is_lost or np.diag(away.covariance).min() > 1.0


def test_the_papers_preset_closes_loops_by_ransac_and_labels_by_bags(look, standpoint):
    x, y = standpoint
    turns = [
        np.array([[np.sin(a), 0, np.cos(a), x], [-np.cos(a), 0, np.sin(a), y], [0, -1, 0, 1.3]])
        for a in np.r_[0.0:2.0:0.1, 0.0:1.0:0.1]
    ]
    poses = [np.vstack([top, [0, 0, 0, 1]]) for top in turns]
    closer = LoopCloser.from_preset("paper")
    candidates = []
    for k, T in enumerate(poses):
        frame = replace(look(T, k), stamp_s=k / 5)
        candidates += closer.process(frame, se3.inverse(poses[0]) @ T).candidates
    between = [c for c in candidates if not np.isnan(c.rmse_m) and c.eta <= 3.0]
    assert closer.map.n_global_registrations == len(between) > 0
    loops = closer.map.loops
    assert len(loops) > 2
    for loop in loops:
        truth = se3.inverse(poses[loop.match_id]) @ poses[loop.query_id]
        assert np.linalg.norm((loop.T_match_query - truth)[:3, 3]) < 0.02
    classes = models.resolve().bag_classifier.classes_
    assert closer.map.keyframes[-1].scene.classes == tuple(classes)
