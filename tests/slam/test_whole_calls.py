"""A call of the loop closer happens whole or not at all, and in one thread at a time."""

import linecache
import random
import sys
import threading

import numpy as np
import pytest

from slam_bof.errors import FrameError
from slam_bof.slam import LoopCloser
from slam_bof.types import CandidateSource, DepthFrame, EdgeKind, Intrinsics


def fresh(frame):
    """Return a frame without what was computed of it before."""
    return DepthFrame(frame.stamp_s, frame.depth, frame.intrinsics)


class InterruptAt:
    """Raises at the n-th line that this thread runs inside of slam_bof, and counts the lines.

    Lines with ``try`` and ``with`` do not count: no signal is delivered between the entry of a lock
    and the ``try`` behind it, nor before its exit.
    """

    def __init__(self, at_line, error):
        self.n_lines, self._at_line, self._error = 0, at_line, error

    def __enter__(self):
        self._before = sys.gettrace()
        sys.settrace(self._trace)
        return self

    def __exit__(self, *_):
        sys.settrace(self._before)

    def _trace(self, frame, event, _):
        if "slam_bof" not in frame.f_code.co_filename or "conftest" in frame.f_code.co_filename:
            return None
        line = linecache.getline(frame.f_code.co_filename, frame.f_lineno)
        if event == "line" and not line.lstrip().startswith(("try:", "with ")):
            self.n_lines += 1
            if self.n_lines == self._at_line:
                raise self._error("interrupted by the test")
        return self._trace


def test_after_an_interruption_anywhere_the_closer_goes_on(walk):
    """Sixty interruptions in keyframes and other frames, two in each call."""
    whole, n_lines = LoopCloser.from_preset(), []
    for frame, T in walk:
        with InterruptAt(-1, KeyboardInterrupt) as counter:
            whole.process(fresh(frame), T)
        n_lines.append(counter.n_lines)
    reference = whole.finish()
    draw, n_interrupted = random.Random(0), 0
    closer = LoopCloser.from_preset()
    for k, (frame, T) in enumerate(walk):
        for _ in range(2):
            error = draw.choice([KeyboardInterrupt, ValueError, MemoryError])
            with InterruptAt(draw.randrange(1, n_lines[k] + 1), error):
                try:
                    closer.process(fresh(frame), T)
                except error:
                    n_interrupted += 1
            if len(closer.history) == k + 1:
                break
        else:
            closer.process(fresh(frame), T)
        assert len(closer.history) == k + 1
    assert n_interrupted >= 60
    assert [k.id for k in closer.map.keyframes] == list(range(len(whole.map)))
    np.testing.assert_allclose(closer.finish().poses, reference.poses, atol=2e-3)
    assert sum(loop.kind == EdgeKind.LOOP for loop in closer.map.loops) >= 3


def test_an_interrupted_finish_can_be_called_again(walk):
    closer = LoopCloser.from_preset()
    for frame, T in walk[:30]:
        closer.process(frame, T)
    for at_line in (5, 60, 100, 150):
        with InterruptAt(at_line, KeyboardInterrupt), pytest.raises(KeyboardInterrupt):
            closer.finish()
    assert len(closer.finish()) == 30
    assert closer.process(*walk[30]).T_map_odom.shape == (4, 4)


def test_a_frame_that_failed_changes_nothing(walk):
    """Tracking and recognition give the same bytes; iSAM2 has started afresh."""
    plain, failing = LoopCloser.from_preset(), LoopCloser.from_preset()
    add_keyframe, n_failed = failing.map.graph.backend.add_keyframe, 0
    n_scores = 0
    for k, (frame, T) in enumerate([*walk[:6], *walk[20:26]]):
        expected = plain.process(fresh(frame), T)
        failing.map.graph.backend.add_keyframe = lambda *_: 1 / 0
        try:
            found = failing.process(fresh(frame), T)
        except ZeroDivisionError:
            n_failed += 1
            failing.map.graph.backend.add_keyframe = add_keyframe
            found = failing.process(fresh(frame), T)
        assert len(failing.history) == len(plain.history) == k + 1
        poses = [closer.history.frames[-1].T_odom_camera for closer in (plain, failing)]
        np.testing.assert_array_equal(*poses)
        assert scores(found) == scores(expected)
        n_scores += len(scores(expected))
        np.testing.assert_allclose(found.T_map_odom, expected.T_map_odom, atol=0.02)
    assert n_failed == len(plain.map) >= 4
    assert n_scores


def scores(step):
    """Return which views recognition proposed, and how similar they are."""
    views = [c for c in step.candidates if c.source == CandidateSource.VIEW]
    return [(c.query_id, c.match_id, c.score) for c in views]


def test_calls_of_several_threads_wait_for_each_other(walk):
    closer, errors, lock, todo = LoopCloser.from_preset(), [], threading.Lock(), list(walk[:16])

    def work():
        while True:
            with lock:
                if not todo:
                    return
                frame, T = todo.pop(0)
            try:
                closer.process(fresh(frame), T)
            except FrameError as error:
                errors.append(error)  # a frame that a later one has overtaken

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(closer.history) + len(errors) == 16
    assert all("time stamps must increase" in str(error) for error in errors)
    assert len(closer.finish()) == len(closer.history)


def test_a_call_from_inside_a_call_is_refused(walk):
    closer = LoopCloser.from_preset(journal=lambda _: closer.finish())
    with pytest.raises(RuntimeError, match="inside another call of the same loop closer"):
        closer.process(*walk[0])


def test_what_a_journal_could_not_save_is_saved_with_the_next_keyframe(walk):
    saved, fail = [], [False, True, True, False, False]

    def journal(record):
        if fail and fail.pop(0):
            raise OSError("disk full")
        saved.append(record.keyframe.id)

    closer, n_errors = LoopCloser.from_preset(journal=journal), 0
    for frame, T in walk[:14]:
        try:
            closer.process(frame, T)
        except OSError:
            n_errors += 1
    assert n_errors == 2
    assert saved == list(range(len(closer.map)))
    assert len(closer.history) == 14


def test_finish_passes_the_journal_what_it_could_not_save(walk):
    saved = []

    def journal(record):
        if not closer.is_repaired:
            raise OSError("disk full")
        saved.append(record.keyframe.id)

    closer = LoopCloser.from_preset(journal=journal)
    closer.is_repaired = False
    for call in (lambda: closer.process(*walk[0]), closer.finish):
        with pytest.raises(OSError, match="disk full"):
            call()
    closer.is_repaired = True
    assert len(closer.finish()) == 1
    assert saved == [0]


def change(T, at, value):
    T = T.copy()
    T[at] = value
    return T


@pytest.mark.parametrize(
    ("T", "message"),
    [
        (change(np.eye(4), (3, 0), 0.5), "found a last row 0.5 0 0 1, expected 0 0 0 1"),
        (change(np.eye(4), (3, 3), 2.0), "found a last row 0 0 0 2, expected 0 0 0 1"),
        (change(np.eye(4), (0, 3), np.nan), "found NaN or infinity"),
        (np.eye(3), r"found an array \(3, 3\)"),
        ("here", "found an array of <U4, expected numbers"),
        (None, "found an array of object"),
        ([[1, 2], [3]], "inhomogeneous"),
        ({}, "found an array of object"),
        (1j * np.eye(4), "found an array of complex128"),
    ],
)
def test_a_pose_that_is_none_is_refused_and_the_frame_ignored(walk, T, message):
    closer = LoopCloser.from_preset()
    with pytest.raises(FrameError, match=message):
        closer.process(walk[0][0], T)
    with pytest.raises(FrameError, match=message):
        closer.process_points(0.0, np.ones((200, 3)), T)
    assert len(closer.history) == 0
    assert closer.process(*walk[0]).keyframe is not None


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.eye(5), "expected .6, 6. numbers"),
        ("here", "expected .6, 6. numbers"),
        ([[1.0], [1.0, 2.0]], "inhomogeneous"),
        (1j * np.eye(6), "expected .6, 6. numbers"),
        (np.nan * np.eye(6), "expected 36 finite numbers"),
    ],
)
def test_a_covariance_that_is_none_is_refused(walk, covariance, message):
    closer = LoopCloser.from_preset()
    with pytest.raises(FrameError, match=f"covariance of frame 0: .*{message}"):
        closer.process(*walk[0], covariance)
    assert len(closer.history) == 0


def test_the_pose_of_a_sensor_in_its_frame_is_checked(walk):
    closer = LoopCloser.from_preset()
    with pytest.raises(FrameError, match=r"T_view_camera of frame 0, at 0.0 s: found an array"):
        closer.process(*walk[0], T_view_camera=[1.0, 2.0])
    with pytest.raises(ValueError, match=r"points_camera must be numbers"):
        closer.process_points(0.0, 1j * np.ones((200, 3)), np.eye(4))
    assert len(closer.history) == 0


def test_poses_are_copied(walk):
    """An odometry may reuse the array."""
    closer, T = LoopCloser.from_preset(), np.eye(4)
    for k in range(3):
        T[0, 3] = 0.01 * k
        closer.process(walk[k][0], T)
    assert [frame.T_odom_raw[0, 3] for frame in closer.history.frames] == [0.0, 0.01, 0.02]


@pytest.mark.parametrize(
    ("stamp_s", "depth", "message"),
    [
        ("0.5", np.ones((2, 2)), "stamp_s must be a number of seconds, got '0.5'"),
        (None, np.ones((2, 2)), "stamp_s must be a number of seconds, got None"),
        (True, np.ones((2, 2)), "stamp_s must be a number of seconds, got True"),
        (10**400, np.ones((2, 2)), "stamp_s must be a number of seconds, got 1000"),
        (0.5, [[1.0, 1.0], [1.0, 1.0]], "depth must be a NumPy array, got a list"),
        (0.5, np.ones((0, 0)), r"depth must be \(2, 2\)"),
    ],
)
def test_what_is_no_frame_is_refused(stamp_s, depth, message):
    with pytest.raises(ValueError, match=message):
        DepthFrame(stamp_s, depth, Intrinsics(2, 2, 2.0, 2.0, 0.5, 0.5))
