"""Frames and poses that come late, out of order, twice or not at all."""

import numpy as np
import pytest
from conftest import CAMERA
from hypothesis import given, settings, strategies as st

from slam_bof.datasets import FramePoseSynchroniser
from slam_bof.datasets.synchroniser import SynchroniserParams
from slam_bof.geometry import se3
from slam_bof.types import DepthFrame

DEPTH = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
STEP = se3.exp(np.array([0.0, 0.1, 0.0, 0.1, 0.0, 0.0]))


def frame(k):
    return DepthFrame(0.1 * k, DEPTH, CAMERA)


def pose(k):
    return se3.exp(k * se3.log(STEP))


def stamps(pairs):
    return [round(10 * pair[0].stamp_s) for pair in pairs]


def test_frames_wait_for_their_poses_and_keep_their_order():
    pairing = FramePoseSynchroniser()
    for k in (0, 2, 1):
        assert pairing.add_frame(frame(k))
    pairing.add_pose(0.1, pose(1))
    assert pairing.take() == []
    pairing.add_pose(0.0, pose(0))
    first = pairing.take()
    assert stamps(first) == [0, 1]
    np.testing.assert_allclose(first[1][1], pose(1))
    assert pairing.n_waiting == 1
    assert not pairing.counts


@pytest.mark.parametrize("pose_first", [True, False])
@pytest.mark.parametrize("broken", ["pose", "frame", "both"])
def test_one_stamp_from_the_future_is_not_the_clock(broken, pose_first):
    pairing, taken = FramePoseSynchroniser(), []
    for k in range(60):
        future = 10_000_000 if k == 20 else 0

        def add_frame(k=k, future=future):
            pairing.add_frame(frame(k + future * (broken != "pose")))

        def add_pose(k=k, future=future):
            pairing.add_pose(0.1 * (k + future * (broken != "frame")), pose(k))

        for add in (add_pose, add_frame) if pose_first else (add_frame, add_pose):
            add()
            taken += pairing.take()
    # A pose in between is interpolated; the frame of the future waits for its time.
    expected = [k for k in range(60) if k != 20 or broken == "pose"]
    assert [k for k in stamps(taken) if k < 59] == expected[:-1]
    assert pairing.counts.total() <= 1


def test_a_clock_that_has_really_jumped_is_followed():
    pairing = FramePoseSynchroniser()
    for k in (0, 1, 2, 5000, 5001, 5002):
        pairing.add_frame(frame(k))
        pairing.add_pose(0.1 * k, pose(k))
    assert stamps(pairing.take()) == [0, 1, 2, 5000, 5001, 5002]


def test_between_poses_it_interpolates_once_no_nearer_one_will_come():
    pairing = FramePoseSynchroniser(SynchroniserParams(max_wait_s=0.4))
    pairing.add_frame(frame(1))
    pairing.add_pose(0.05, pose(0.5))
    pairing.add_pose(0.15, pose(1.5))
    assert pairing.take() == []
    pairing.add_pose(0.35, pose(3.5))
    ((_, T),) = pairing.take()
    np.testing.assert_allclose(T, pose(1), atol=1e-9)


def test_a_frame_without_a_pose_is_dropped_by_name_and_the_others_go_on():
    pairing = FramePoseSynchroniser()
    for k in range(3):
        pairing.add_frame(frame(k))
    pairing.add_pose(0.0, pose(0))
    pairing.add_pose(0.2, pose(2))
    pairing.add_pose(1.5, pose(15))
    assert stamps(pairing.take()) == [0, 1, 2]
    pairing.add_frame(frame(4))
    pairing.add_frame(frame(15))
    assert stamps(pairing.take()) == [15]
    assert [(d.stamp_s, d.reason) for d in pairing.dropped] == [(0.4, "frame's pose did not come")]


def test_when_full_it_refuses_and_takes_again_after_poses():
    pairing = FramePoseSynchroniser(SynchroniserParams(max_frames=2))
    assert [pairing.add_frame(frame(k)) for k in range(3)] == [True, True, False]
    assert pairing.is_full
    pairing.add_pose(0.0, pose(0))
    assert stamps(pairing.take()) == [0]
    assert pairing.add_frame(frame(2))


def test_what_comes_twice_or_too_late_is_counted():
    pairing = FramePoseSynchroniser()
    pairing.add_frame(frame(1))
    pairing.add_frame(frame(1))
    pairing.add_pose(0.1, pose(1))
    pairing.add_pose(0.1, pose(1))
    pairing.take()
    pairing.add_frame(frame(0))
    pairing.add_pose(-0.5, pose(-5))
    assert sum(pairing.counts.values()) == 4
    assert {d.reason.split(" ")[0] for d in pairing.dropped} == {"frame", "pose"}


def test_poses_that_are_none_are_refused():
    pairing = FramePoseSynchroniser()
    with pytest.raises(ValueError, match="no rotation"):
        pairing.add_pose(0.0, np.diag([2.0, 2.0, 2.0, 1.0]))
    for stamp_s in (
        np.nan,
        -np.inf,
        "1.0",
        None,
        [],
        1j,
        np.datetime64("2026-01-01"),
        True,
        10**400,
    ):
        with pytest.raises(ValueError, match="a pose's stamp must be finite"):
            pairing.add_pose(stamp_s, np.eye(4))
    for T in (np.eye(4)[:3], 1j * np.eye(4), "here", None):
        with pytest.raises(ValueError, match="found a"):
            pairing.add_pose(0.0, T)
    assert pairing.n_waiting == 0


@given(st.permutations(range(12)), st.permutations(range(12)), st.sets(st.integers(0, 11)))
@settings(max_examples=60)
def test_every_frame_is_given_out_once_or_dropped(frames, poses, missing):
    pairing = FramePoseSynchroniser(SynchroniserParams(max_frames=12, max_poses=8))
    given_out = []
    for k, j in zip(frames, poses, strict=True):
        assert pairing.add_frame(frame(k))
        if j not in missing:
            pairing.add_pose(0.1 * j, pose(j))
        given_out += pairing.take()
        assert len(pairing._stamps_s) <= 8
    given_out += pairing.take(at_end=True)
    found = stamps(given_out)
    assert found == sorted(set(found))
    assert pairing.n_waiting == 0
    lost = [round(10 * d.stamp_s) for d in pairing.dropped if d.reason.startswith("frame")]
    assert sorted(found + lost) == list(range(12))
    for seen, T in given_out:
        np.testing.assert_allclose(T, pose(10 * seen.stamp_s), atol=1e-6)
