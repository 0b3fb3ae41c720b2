"""The contract of odometry plug-ins, as a test."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from slam_bof.geometry import se3
from slam_bof.ports import Odometry, ResumableOdometry
from slam_bof.testing.scenery import blind, example_frames, expect, expect_rigid
from slam_bof.types import Array, DepthFrame

__all__ = ["check_odometry"]


def check_odometry(
    make: Callable[[], Odometry],
    *,
    frames: Sequence[DepthFrame] | None = None,
    truth: Array | None = None,
    max_error_m: float | None = None,
) -> None:
    """Check that an odometry obeys its port.

    Poses are rotations and translations; the first is the identity; the same frames give the
    same bytes, from another instance and after ``reset``; frames and poses handed out are left
    alone; frames that show nothing, at the beginning or in between, do no harm. One with ``state``
    and ``restore`` continues from a saved state with the same bytes.

    Parameters
    ----------
    make
        Makes a new one: its class, if it needs no arguments.
    frames, truth
        At least 6 frames and their poses (N, 4, 4) relative to the first, for one that is made
        for frames of its own (a recorded trajectory); by default ``example_frames()``.
    max_error_m
        How far the last pose may be from the truth, with and without blind frames in between;
        None: that is not asked.

    Raises
    ------
    AssertionError
        In words.
    """
    if frames is None:
        frames, truth = example_frames()
    odometry = make()
    expect(isinstance(odometry, Odometry), "it must have process and reset, as slam_bof.ports says")
    images = [frame.depth.copy() for frame in frames]
    poses = _track(odometry, frames)
    expect(bool(np.allclose(poses[0], np.eye(4), atol=1e-9)), "the first pose must be the identity")
    for frame, image in zip(frames, images, strict=True):
        expect(np.array_equal(frame.depth, image, equal_nan=True), "frames must not be changed")
    again = _track(make(), frames, spoil=True)
    expect(
        poses.tobytes() == again.tobytes(),
        "another instance must give the same poses to the byte, whatever became of the arrays "
        "that it returned; seeds and threads held to one help",
    )
    odometry.reset()
    again = _track(odometry, frames)
    expect(poses.tobytes() == again.tobytes(), "after reset the same frames must give the same")
    _check_error(poses, truth, max_error_m, "")
    _check_blindness(make, frames, truth, max_error_m)
    if isinstance(odometry, ResumableOdometry):
        _check_state(make, frames, poses)


def _check_blindness(
    make: Callable[[], Odometry],
    frames: Sequence[DepthFrame],
    truth: Array | None,
    max_error_m: float | None,
) -> None:
    middle = len(frames) // 2
    for as_float in (False, True):
        for kind in (0, 1):
            seen = list(frames)
            seen[middle] = blind(seen[middle], as_float=as_float)[kind]
            _check_error(_track(make(), seen), truth, max_error_m, " with a blind frame in between")
            poses = _track(make(), [blind(frames[0], as_float=as_float)[kind], *frames[1:4]])
            expect(
                bool(np.allclose(poses[0], np.eye(4), atol=1e-9)),
                "the first pose must be the identity of a blind frame, too",
            )
    nothing = [blind(frame)[0] for frame in frames[:4]]
    _track(make(), nothing)


def _check_state(make: Callable[[], Odometry], frames: Sequence[DepthFrame], poses: Array) -> None:
    """Check that a saved state can be continued, whatever became of the odometry it is of."""
    for n in (0, 1, len(frames) // 2):
        before, after = make(), make()
        assert isinstance(before, ResumableOdometry)
        assert isinstance(after, ResumableOdometry)
        _track(before, frames[:n])
        state = before.state()
        expect(
            all(isinstance(array, np.ndarray) and array.dtype.kind in "biuf"
                for array in state.values()),
            "state must return arrays of numbers by name",
        )  # fmt: skip
        state = {name: array.copy() for name, array in state.items()}
        _track(before, frames[n : n + 2])
        _track(after, frames[-2:])
        after.restore(state)
        expect(
            _track(after, frames[n:]).tobytes() == poses[n:].tobytes(),
            f"restored to a state after {n} frames, it must give the same poses to the byte",
        )
        for name in state:
            try:
                after.restore({key: array for key, array in state.items() if key != name})
            except ValueError:
                continue
            expect(False, f"restore must raise ValueError for a state without {name}")


def _track(odometry: Odometry, frames: Sequence[DepthFrame], *, spoil: bool = False) -> Array:
    poses = []
    for index, frame in enumerate(frames):
        T = odometry.process(frame)
        expect_rigid(T, f"the pose of frame {index}")
        poses.append(T.copy())
        if spoil:
            T[:] = np.nan
    return np.array(poses)


def _check_error(poses: Array, truth: Array | None, max_error_m: float | None, when: str) -> None:
    if truth is None or max_error_m is None:
        return
    error_m = float(np.linalg.norm((se3.inverse(truth[-1]) @ poses[-1])[:3, 3]))
    expect(
        error_m <= max_error_m,
        f"after {len(poses)} frames{when} the pose is off by {error_m:.3f} m, {max_error_m:g} m "
        "are allowed",
    )
