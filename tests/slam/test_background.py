"""Mapping in a process of its own: the same results, nothing lost, and errors that come back."""

import gc
import os
import signal
import time

import numpy as np
import pytest

from slam_bof.errors import SlamBofError
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.background import MAX_WAITING
from slam_bof.slam.config import override
from slam_bof.slam.mapping import KeyframeJob
from slam_bof.types import EdgeKind


@pytest.fixture
def background():
    """Make loop closers whose processes end with the test."""
    closers = []

    def make(*args, **options):
        closers.append(LoopCloser.from_config(preset("indoor"), *args, background=True, **options))
        return closers[-1]

    yield make
    for closer in closers:
        closer.close()


def test_with_drain_every_step_is_that_of_the_caller_s_thread(walk, background):
    records = {False: [], True: []}
    direct = LoopCloser.from_preset(journal=records[False].append)
    beside = background(journal=records[True].append)
    for frame, T in walk:
        expected = direct.process(frame, T)
        beside.process(frame, T)
        beside.drain()
        found = beside.poll()
        np.testing.assert_array_equal(found.T_map_odom, expected.T_map_odom)
        assert (found.keyframe is None) == (expected.keyframe is None)
        assert [(c.match_id, c.reason) for c in found.candidates] == [
            (c.match_id, c.reason) for c in expected.candidates
        ]
    np.testing.assert_array_equal(beside.finish().poses, direct.finish().poses)
    np.testing.assert_array_equal(beside.map.poses(), direct.map.poses())
    assert len(beside.map.loops) == len(direct.map.loops) > 0
    assert beside.map.n_components == direct.map.n_components
    ours, theirs = beside.map.outline(), direct.map.outline()
    assert len(ours) == len(direct.map) == len(ours.labels)
    for name in ("stamps_s", "T_map_camera", "components", "edges", "is_loop"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert (ours.labels, ours.rooms) == (theirs.labels, theirs.rooms)
    assert [tuple(edge) for edge in ours.edges[ours.is_loop].tolist()] == [
        (loop.match_id, loop.query_id) for loop in direct.map.loops if loop.kind == EdgeKind.LOOP
    ]
    assert len(records[True]) == len(records[False]) == len(direct.map)
    for ours, theirs in zip(records[True], records[False], strict=True):
        assert ours.state == theirs.state
        assert [f.stamp_s for f in ours.frames] == [f.stamp_s for f in theirs.frames]
        np.testing.assert_array_equal(ours.depth.depth, theirs.depth.depth)


def test_without_drain_nothing_is_lost(walk, background):
    """Each keyframe comes back with one step or another, and every frame has a pose."""
    closer, loops, chosen = background(), [], []
    assert closer.poll() is None
    for k, (frame, T) in enumerate(walk):
        step = closer.process(frame, T)
        assert step.T_map_odom.shape == (4, 4)
        loops += step.loops
        if step.is_keyframe:
            chosen.append(k)
    closer.drain()
    assert chosen == [keyframe.frame_index for keyframe in closer.map.keyframes]
    assert closer.n_waiting == 0
    last = closer.poll()
    assert len(loops) + len(last.loops) == len(closer.map.loops) > 0
    assert closer.poll().loops == ()
    np.testing.assert_array_equal(closer.poll().T_map_odom, last.T_map_odom)
    assert len(closer.finish()) == len(walk)


def test_while_too_many_wait_no_frame_becomes_a_keyframe(walk, background):
    closer = background()
    os.kill(closer._mapping._process.pid, signal.SIGSTOP)
    try:
        for frame, T in walk[:30]:
            closer.process(frame, T)
        assert closer.n_waiting == MAX_WAITING
        n_postponed = closer.n_postponed
        assert n_postponed > 0
    finally:
        os.kill(closer._mapping._process.pid, signal.SIGCONT)
    closer.drain()
    for frame, T in walk[30:]:
        closer.process(frame, T)
        closer.drain()
    assert closer.n_postponed == n_postponed
    assert len(closer.map) > MAX_WAITING
    assert len(closer.finish()) == len(walk)


def test_an_error_of_a_keyframe_is_raised_by_the_next_call(walk, background):
    closer = background()
    closer.process(*walk[0])
    closer.drain()
    broken = KeyframeJob("no frame", None)
    closer._mapping._unsent.append(broken)
    with pytest.raises(AttributeError, match="track") as caught:
        closer.drain()
    assert "slam_bof/slam/mapping.py" in "".join(caught.value.__notes__)
    for frame, T in walk[1:10]:
        closer.process(frame, T)
    assert len(closer.finish()) == 10
    assert len(closer.map) >= 2


def test_a_process_that_is_killed_is_reported(walk, background):
    closer = background()
    closer.process(*walk[0])
    closer._mapping._process.kill()
    closer._mapping._process.wait()
    with pytest.raises(SlamBofError, match="background has ended with status -9"):
        closer.drain()
    with pytest.raises(SlamBofError, match="background has ended"):
        closer.process(*walk[1])


def test_what_cannot_be_built_is_refused_at_once(tmp_path):
    config = override(preset("indoor"), [f"model={tmp_path / 'none.bof'}"])
    with pytest.raises(SlamBofError, match=r"none\.bof"):
        LoopCloser.from_config(config, background=True)


def test_a_map_is_restored_and_a_session_begun(walk, background):
    records = []
    first = LoopCloser.from_preset(journal=records.append)
    for frame, T in walk[:20]:
        first.process(frame, T)
    closer = background()
    closer.restore(records)
    n_frames = len(closer.history)
    for frame, T in walk[n_frames:22]:
        closer.process(frame, T)
    assert len(closer.finish()) == 22
    closer.begin_session()
    closer.process(*walk[0])
    assert len(closer.finish()) == 1
    assert closer.map.session == 1
    assert closer.map.keyframes[-1].session == 1


def test_the_process_ends_with_its_loop_closer(walk):
    closer = LoopCloser.from_preset(background=True)
    process = closer._mapping._process
    closer.process(*walk[0])
    closer.drain()
    del closer
    gc.collect()  # its map refers back to it
    deadline_s = time.monotonic() + 10.0
    while process.poll() is None and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert process.returncode in (0, -signal.SIGKILL)  # killed if it takes five seconds to end
