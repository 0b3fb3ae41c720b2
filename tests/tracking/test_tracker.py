"""Slips are mended, losses are noticed, and what was lost is found or begun anew."""

from dataclasses import replace

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.slam import LoopCloser
from slam_bof.synthetic import DegenerateCase, drifted, render_case
from slam_bof.tracking import Tracker, TrackingParams, frame_finder

N_FRAMES = 12
STEP_RAD = 0.06


def turned(standpoint, yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = standpoint
    return np.array([[s, 0, c, x], [-c, 0, s, y], [0, -1, 0, 1.3], [0, 0, 0, 1.0]])


@pytest.fixture(scope="module")
def turn(look, standpoint):
    """Frames of a turn on the spot, and the true poses seen from the first."""
    poses = np.array([turned(standpoint, 2.0 + STEP_RAD * i) for i in range(N_FRAMES)])
    return [look(pose, i) for i, pose in enumerate(poses)], se3.inverse(poses[0]) @ poses


def covered(frame):
    return replace(frame, depth=np.zeros_like(frame.depth))


def follow(frames, odometry, every=4):
    """Track all, keep some, and return the tracks."""
    tracker = Tracker()
    tracks = []
    for i, (frame, T) in enumerate(zip(frames, odometry, strict=True)):
        tracks.append(tracker.track(frame, T))
        anew = len(tracks) > 1 and tracks[-1].segment != tracks[-2].segment
        if not tracks[-1].is_lost and (i % every == 0 or anew):
            tracker.keep()
    return tracker, tracks


def off(tracks, truth):
    T = se3.inverse(truth) @ np.array([track.T_odom_camera for track in tracks])
    return np.linalg.norm(T[:, :3, 3], axis=1), np.degrees(se3.rotation_angle(T))


def test_slips_are_mended(turn):
    frames, truth = turn
    tangents = np.outer(np.arange(N_FRAMES), [0.0, 0.02, 0.005, 0.03, 0.0, 0.02])
    slips = se3.exp(tangents)  # 4 cm and 1.2 degrees more in each frame
    tracker, tracks = follow(frames, truth @ slips)
    far_m, far_deg = off(tracks, truth)
    assert off(follow(frames, truth)[1], truth)[0].max() < 0.03
    assert far_m.max() < 0.03
    assert far_deg.max() < 1.0
    assert tracker.n_lost == 0
    assert min(track.inlier_ratio for track in tracks) > 0.5


def test_a_covered_lens_is_a_loss_and_the_place_is_found_again(turn):
    frames, truth = turn
    dark = [covered(f) if 5 <= i < 8 else f for i, f in enumerate(frames)]
    # Odometry stands still while it sees nothing, and goes on from there.
    odometry = truth.copy()
    odometry[5:8] = truth[4]
    odometry[8:] = truth[4] @ se3.inverse(truth[8]) @ truth[8:]
    tracker, tracks = follow(dark, odometry)
    assert [track.is_lost for track in tracks] == [5 <= i < 8 for i in range(N_FRAMES)]
    assert tracker.n_lost == 1
    assert tracks[-1].segment == 0
    assert off(tracks[8:], truth[8:])[0].max() < 0.03


def test_elsewhere_the_track_begins_anew(turn, look, standpoint):
    frames, truth = turn
    behind = [look(turned(standpoint, 5.2 + STEP_RAD * i), 20 + i) for i in range(4)]
    odometry = np.concatenate([truth, truth[:4]])  # restarted: identity again
    tracker, tracks = follow(frames + behind, odometry)
    assert [track.segment for track in tracks] == [0] * (N_FRAMES + 1) + [1] * 3
    assert [track.is_lost for track in tracks] == [False] * N_FRAMES + [True] + [False] * 3
    assert tracker.n_lost == 1


def test_an_image_that_is_given_twice_does_not_confirm_itself(turn, look, standpoint):
    frames, truth = turn
    elsewhere = look(turned(standpoint, 5.2), 20)
    again = replace(elsewhere, stamp_s=20.5)
    shown = [*frames[:6], elsewhere, again, *frames[6:]]
    _, tracks = follow(shown, np.concatenate([truth[:6], truth[5:6], truth[5:]]))
    assert [track.is_lost for track in tracks] == [i in (6, 7) for i in range(N_FRAMES + 2)]
    assert {track.segment for track in tracks} == {0}


def trusting(frames, odometry):
    """Track frames as ``follow`` does, with odometry that is known to be precise."""
    tracker = Tracker()
    tracker.trusts_odometry = True
    tracks = []
    for i, (frame, T) in enumerate(zip(frames, odometry, strict=True)):
        tracks.append(tracker.track(frame, T))
        if not tracks[-1].is_lost and i % 4 == 0:
            tracker.keep()
    return tracks


def test_trusted_odometry_is_believed_where_frames_contradict_it(turn, look, standpoint):
    frames, truth = turn
    elsewhere = look(turned(standpoint, 5.2), 20)
    shown = [*frames[:6], elsewhere, *frames[7:]]
    _, tracks = follow(shown, truth)
    assert tracks[6].is_lost
    tracks = trusting(shown, truth)
    assert not any(track.is_lost for track in tracks)
    assert max(off(tracks, truth)[0]) < 0.02


def test_trusted_odometry_that_leaps_is_not_believed(turn, look, standpoint):
    frames, truth = turn
    leap = se3.pose(np.eye(3), np.array([5.0, 0.0, 0.0]))
    tracks = trusting([*frames, look(turned(standpoint, 5.2), 20)], [*truth, truth[-1] @ leap])
    assert tracks[-1].is_lost


def noisy(frame, sigma):
    """Depths off by a share of themselves, each pixel on its own."""
    shares = 1.0 + sigma * np.random.default_rng(0).standard_normal(frame.depth.shape)
    return replace(frame, depth=(frame.depth_m() * shares).astype(np.float32))


def test_what_is_usual_depends_on_the_sensor(turn):
    """So noisy that right poses agree by half only, which elsewhere would be a loss."""
    frames, truth = turn
    poor = [noisy(frame, 0.07) for frame in frames]
    tracker, tracks = follow([*poor, covered(frames[-1])], np.concatenate([truth, truth[-1:]]))
    assert max(track.inlier_ratio for track in tracks[1:-1]) < 0.65
    assert [track.is_lost for track in tracks] == [False] * N_FRAMES + [True]
    assert tracker.n_lost == 1


def test_nothing_is_lost_before_anything_was_seen(turn):
    frames, truth = turn
    tracker, tracks = follow([covered(f) for f in frames[:3]] + frames[3:], truth)
    assert [track.is_lost for track in tracks] == [True] * 3 + [False] * (N_FRAMES - 3)
    assert tracker.n_lost == 0


def test_it_can_be_turned_off(turn):
    frames, truth = turn
    tracker = Tracker(TrackingParams(enabled=False))
    for frame, T in zip(frames[:3], truth, strict=False):
        track = tracker.track(covered(frame), T)
        assert track.T_odom_camera is T
        assert not track.is_lost


@pytest.fixture(scope="module")
def rounds(look, standpoint):
    """Twice round on the spot; the odometry is started anew in between, at another yaw."""
    yaws = np.concatenate([np.arange(0, 2.2, 0.1), np.arange(0.05, 2.2, 0.1)])
    poses = np.array([turned(standpoint, yaw) for yaw in yaws])
    frames = [look(pose, i) for i, pose in enumerate(poses)]
    odometry = se3.inverse(poses[0]) @ poses
    odometry[22:] = se3.inverse(poses[22]) @ poses[22:]
    return frames, odometry, poses


def test_a_verified_loop_joins_what_was_lost(rounds):
    frames, odometry, poses = rounds
    closer = LoopCloser.from_preset("indoor")
    steps = [closer.process(f, T) for f, T in zip(frames, odometry, strict=True)]
    trajectory = closer.finish()
    assert closer.n_odometry_lost == 1
    assert closer.map.n_components == 1
    assert closer.map.keyframes[-1].segment == 1
    joined = [loop for step in steps for loop in step.loops if loop.source == "view"]
    assert joined
    off = se3.inverse(se3.inverse(poses[0]) @ poses) @ trajectory.poses
    lost = np.array([step.is_lost for step in steps])
    assert np.linalg.norm(off[~lost, :3, 3], axis=1).max() < 0.05
    last = steps[-1].T_map_odom @ odometry[-1]
    assert np.linalg.norm(last[:3, 3] - (se3.inverse(poses[0]) @ poses[-1])[:3, 3]) < 0.05


def test_what_nothing_joins_stays_a_part_of_its_own(look, standpoint):
    yaws = np.concatenate([np.arange(0, 0.6, 0.1), np.pi - 0.4 + np.arange(0, 0.6, 0.1)])
    frames = [look(turned(standpoint, yaw), i) for i, yaw in enumerate(yaws)]
    poses = np.array([turned(standpoint, yaw) for yaw in yaws])
    odometry = se3.inverse(poses[0]) @ poses
    odometry[6:] = se3.inverse(poses[6]) @ poses[6:]
    closer = LoopCloser.from_preset("indoor")
    for frame, T in zip(frames, odometry, strict=True):
        closer.process(frame, T)
    trajectory = closer.finish()
    assert closer.map.n_components == 2
    assert len(trajectory) == 12
    assert np.isfinite(trajectory.poses).all()


def errors_m(tracks, poses):
    truth = se3.inverse(poses[0]) @ poses
    found = np.array([track.T_odom_camera for track in tracks])
    return np.linalg.norm((se3.inverse(truth) @ found)[:, :3, 3], axis=1)


def walk(scene, covariance=None, odometry=None, rate_hz=10.0):
    """Track a camera through a degenerate scene beside exact odometry or another."""
    case = DegenerateCase(scene, sensor="kinect", rate_hz=rate_hz)
    poses = case.poses()
    if odometry is None:
        odometry = se3.inverse(poses[0]) @ poses
    tracker, tracks = Tracker(), []
    for k, frame in enumerate(render_case(case)):
        tracks.append(tracker.track(frame, odometry[k], covariance))
        if k % 5 == 0:
            tracker.keep()
    return tracks, poses


def test_exact_odometry_past_a_wall_stays_exact():
    tracks, poses = walk("wall")
    assert all(track.open_axes.shape[1] == 3 for track in tracks[1:])
    assert errors_m(tracks, poses).max() < 0.006


def test_odometry_that_drifts_past_a_wall_is_made_no_worse():
    """The wall holds the camera's turn, and says nothing of where along the wall it is."""
    poses = DegenerateCase("wall", sensor="kinect", rate_hz=10.0).poses()
    odometry = drifted(poses, axis=np.array([0.0, 0.0, 1.0]))
    tracks, _ = walk("wall", odometry=odometry)
    off = se3.inverse(se3.inverse(poses[0]) @ poses) @ odometry
    off_m = np.linalg.norm(off[:, :3, 3], axis=1)
    assert errors_m(tracks, poses).max() < off_m.max()
    found = se3.inverse(se3.inverse(poses[0]) @ poses[-1]) @ tracks[-1].T_odom_camera
    assert se3.rotation_angle(found) < 0.3 * se3.rotation_angle(off[-1])


@pytest.mark.parametrize(
    "case",
    [
        DegenerateCase("glass", "wheeled", "kinect", 5.0),
        DegenerateCase("glass", "handheld", "kinect", 5.0),
        DegenerateCase("glass", "handheld", "tof", 10.0),
    ],
    ids=lambda case: case.name,
)
def test_where_too_few_pixels_have_neighbours_exact_odometry_stays_exact(case):
    tracker = Tracker()
    truth = se3.inverse(case.poses()[0]) @ case.poses()
    for k, (frame, T) in enumerate(zip(render_case(case), truth, strict=True)):
        track = tracker.track(frame, T)
        tracker.keep()
        np.testing.assert_allclose(track.T_odom_camera, T, atol=1e-6)
        assert track.open_axes.shape[1] == (6 if k else 0)


def test_odometry_of_known_covariance_is_corrected_no_further_than_it_may_be_wrong():
    exact, poses = walk("room", covariance=1e-10 * np.eye(6))
    assert errors_m(exact, poses).max() < 0.001
    odometry = se3.inverse(poses[0]) @ poses
    odometry[:, :3, 3] *= 1.1
    loose, _ = walk("room", covariance=1e-3 * np.eye(6), odometry=odometry)
    drift_m = np.linalg.norm(odometry[-1, :3, 3]) / 11.0
    assert errors_m(loose, poses)[-1] < 0.3 * drift_m


def test_along_open_directions_a_step_is_as_uncertain_as_odometry():
    covariance = np.diag([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    tracks, _ = walk("wall", covariance=covariance)
    aside, ahead = tracks[5].step_covariance[3, 3], tracks[5].step_covariance[5, 5]
    assert aside == pytest.approx(5e-4, rel=0.2)  # five frames since the keyframe
    assert ahead < 0.1 * aside


def test_only_frames_whose_score_dropped_are_searched_for(turn, monkeypatch):
    searched = []
    search = frame_finder.search_weak_directions

    def counted(*arguments, **options):
        searched.append(None)
        return search(*arguments, **options)

    monkeypatch.setattr(frame_finder, "search_weak_directions", counted)
    frames, truth = turn
    n_searched = []
    for max_score_drop in (1.0, 0.0):
        tracker = Tracker(TrackingParams(max_score_drop=max_score_drop))
        tracker.track(frames[0], truth[0])
        tracker.keep()
        tracker.track(frames[1], truth[1])  # nothing is usual yet
        searched.clear()
        for frame, T in zip(frames[2:7], truth[2:7], strict=True):
            tracker.track(frame, T)
        n_searched.append(len(searched))
    assert n_searched[0] == 0 < n_searched[1]


def test_with_covariances_a_restored_tracker_goes_on_as_before():
    case = DegenerateCase("room", sensor="kinect", rate_hz=10.0)
    poses = case.poses()
    frames = list(render_case(case))[:14]
    odometry = se3.inverse(poses[0]) @ poses
    odometry[:, :3, 3] *= 1.05
    covariance = np.diag([1e-6] * 3 + [1e-4] * 3)
    whole, restored = (Tracker() for _ in range(2))
    for k in range(8):
        track = whole.track(frames[k], odometry[k], covariance)
        if k in (0, 7):
            whole.keep()
    restored.restore(whole.state(), frames[7], track)
    for k in range(8, 14):
        expected = whole.track(frames[k], odometry[k], covariance)
        found = restored.track(frames[k], odometry[k], covariance)
        np.testing.assert_array_equal(found.T_odom_camera, expected.T_odom_camera)
        np.testing.assert_array_equal(found.step_covariance, expected.step_covariance)
        assert restored.state() == whole.state()


def test_after_a_relocalisation_trusted_odometry_does_not_undo_it(turn):
    """Odometry slips while the lens is covered, although its covariance says it is exact."""
    frames, poses = turn
    slip = se3.exp(np.array([0.0, 0.15, 0.0, 0.1, 0.0, 0.1]))
    odometry = np.concatenate([poses[:6], slip @ poses[6:]])
    tracker, tracks = Tracker(), []
    for k, (frame, T) in enumerate(zip(frames, odometry, strict=True)):
        tracks.append(tracker.track(covered(frame) if k == 5 else frame, T, 1e-10 * np.eye(6)))
        if k == 0:
            tracker.keep()
    found = [track for track in tracks[6:] if not track.is_lost]
    assert found
    assert all(
        np.linalg.norm((se3.inverse(poses[k]) @ tracks[k].T_odom_camera)[:3, 3]) < 0.05
        for k in range(6, N_FRAMES)
        if not tracks[k].is_lost
    )


@pytest.mark.parametrize("is_known", [False, True])
def test_odometry_of_known_covariance_is_believed_while_nothing_is_seen(is_known):
    case = DegenerateCase("room", sensor="kinect", rate_hz=10.0)
    poses, tracker, tracks = case.poses(), Tracker(), []
    covariance = 1e-8 * np.eye(6) if is_known else None
    blind = [9, 10, 11]
    for k, frame in enumerate(list(render_case(case))[:20]):
        if k in blind:
            frame = replace(frame, depth=np.zeros_like(frame.depth))
        tracks.append(tracker.track(frame, se3.inverse(poses[0]) @ poses[k], covariance))
        if k % 4 == 0:
            tracker.keep()
    lost = [k for k, track in enumerate(tracks) if track.is_lost]
    assert lost == ([] if is_known else blind)
    assert {track.segment for track in tracks} == {0}
    assert (tracks[9].open_axes.shape[1] == 6) == is_known
    if is_known:
        assert errors_m(tracks, poses[:20]).max() < 0.001
        assert (np.diag(tracks[11].step_covariance) > np.diag(tracks[9].step_covariance)).all()
