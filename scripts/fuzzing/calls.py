"""Calls from Python with values that no camera and no odometry gives."""

from __future__ import annotations

import dataclasses
import json
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fuzzing.cases import Reader, expect, expect_numbers, nothing, turn
from fuzzing.maps import CONFIG
from slam_bof import LoopCloser, PlaceRecogniser
from slam_bof.core import registry
from slam_bof.datasets import FramePoseSynchroniser
from slam_bof.errors import SlamBofError
from slam_bof.places import Localizer
from slam_bof.types import DepthFrame, Intrinsics, Trajectory

__all__ = ["READERS"]

MAX_ERROR_M = 0.05
"""Largest error of poses when each hostile call was refused."""
SCALARS = (
    *(None, True, 0, -1, 1, 0.5, 1e-320, 1e38, 1e308, float("nan"), float("inf"), float("-inf")),
    *(2**31, 2**63, 2**70, 10**400, np.float16(2), np.array(3.0), np.nan),
    *("", "x", "0.5", b"1", 1j, [], {}, [1.0], np.datetime64("2026-01-01"), object()),
)


@contextmanager
def refusals() -> Iterator[None]:
    """Go on after a ``ValueError`` whose message is one line."""
    try:
        yield
    except ValueError as error:
        expect("\n" not in str(error) and len(str(error)) < 1000, "a long message")


class Refused(SlamBofError):
    """A call refused an argument by ``ValueError``."""


def attempt(call: Callable[[], Any]) -> Any:
    """Return the result of a call; ``Refused`` if it raises ``ValueError``."""
    try:
        return call()
    except ValueError as error:
        raise Refused(str(error)) from error


def mutate_call(place: Path, case: Path, rng: random.Random) -> None:
    """Choose the seed of what is called: the arguments cannot be written."""
    (case / "seed.json").write_text(json.dumps(rng.getrandbits(64)))


def strange_array(array: Any, rng: random.Random) -> Any:
    """Return an array with strange values, shape or type, or something else."""
    kind = rng.randrange(7)
    if kind == 0:
        return rng.choice(SCALARS)
    with np.errstate(all="ignore"):
        if kind == 1:
            names = ("f2", "f4", "f8", "i8", "u1", "u2", "?", "c16", "O", "U8", ">f8", "m8[s]")
            return array.astype(rng.choice(names))
        changed = np.array(array, np.float64)
    if kind == 2:
        return changed.reshape(-1)[: rng.randrange(changed.size)]
    if kind == 3:
        return rng.choice((changed[None], changed.T, changed[:-1], changed[:, :-1], changed[:0]))
    numbers = (np.nan, np.inf, -np.inf, 1e38, -1e300, 1e150, 1e-320, -1.0, 0.0, 2.0, 1e9)
    size = 1 if kind < 6 else changed.size
    for _ in range(rng.choice((1, 3))):
        changed.flat[rng.sample(range(changed.size), size)] = rng.choice(numbers)
    return changed


def strange_frame(frame: DepthFrame, rng: random.Random) -> DepthFrame:
    """Return a frame with one strange argument."""
    camera = {name: getattr(frame.intrinsics, name) for name in Intrinsics.__slots__}
    stamp_s, depth, kind = frame.stamp_s, frame.depth, rng.randrange(4)
    if kind == 0:
        stamp_s = rng.choice(SCALARS)
    elif kind == 1:
        camera[rng.choice(sorted(camera))] = rng.choice(SCALARS)
    elif kind == 2:
        depth = strange_array(depth, rng)
    else:
        depth = strange_array(frame.depth_m(), rng)
    return DepthFrame(stamp_s, depth, Intrinsics(**camera))


def read_value(place: Path, case: Path) -> None:
    """Make a frame, a trajectory, or a pair by a synchroniser."""
    rng = random.Random(json.loads((case / "seed.json").read_text()))
    frames, poses = turn()
    kind = rng.randrange(4)
    if kind < 2:
        frame = attempt(lambda: strange_frame(frames[0], rng))
        expect(bool(frame.depth_m().max() <= 1e12), "depth")
        expect_numbers(frame.intrinsics, "intrinsics")
    elif kind == 2:
        stamps_s = strange_array(np.arange(4.0)[:, None], rng) if rng.random() < 0.5 else range(4)
        trajectory = attempt(lambda: Trajectory(stamps_s, strange_array(np.array(poses[:4]), rng)))
        expect(len(repr(trajectory)) < 200, "a long repr")
    else:
        synchroniser = FramePoseSynchroniser()
        for k in range(8):
            stamp_s = rng.choice(SCALARS) if k == 3 else k / 30
            T = strange_array(poses[k], rng) if k == 5 else poses[k]
            with refusals():
                synchroniser.add_frame(SimpleNamespace(stamp_s=stamp_s))
            with refusals():
                synchroniser.add_pose(stamp_s, T)
        pairs = synchroniser.take(at_end=True)
        expect(len(pairs) >= 6, f"{len(pairs)} of 8 frames came out")
        expect_numbers([T for _, T in pairs], "poses")


@cache
def undisturbed() -> Any:
    """Return the trajectory of six frames of the turn."""
    closer = new_closer()
    for k in range(6):
        closer.process(*good(k))
    return closer.finish().poses


def new_closer() -> LoopCloser:
    """Return a loop closer that makes every frame a keyframe."""
    return LoopCloser.from_config(CONFIG)


def good(k: int) -> tuple[DepthFrame, Any]:
    """Return a frame with its pose, without what was computed of it before."""
    frames, poses = turn()
    return dataclasses.replace(frames[3 * k], stamp_s=k / 10), poses[3 * k]


def read_closer(place: Path, case: Path) -> None:
    """Disturb a loop closer with hostile calls between good frames; they may change nothing."""
    rng = random.Random(json.loads((case / "seed.json").read_text()))
    closer, n_accepted = new_closer(), 0
    for k in range(6):
        frame, T = good(k)
        if k:
            before = len(closer.history)
            with refusals():
                disturb(closer, frame, T, k / 10 - 0.05, rng)
            n_accepted += len(closer.history) - before
        closer.process(frame, T)
    poses = closer.finish().poses
    expect_numbers(poses, "poses")
    if not n_accepted:
        error_m = np.abs(poses - undisturbed())[:, :3, 3].max()
        expect(bool(error_m < MAX_ERROR_M), f"poses {error_m:.3f} m off")


def disturb(
    closer: LoopCloser, frame: DepthFrame, T: Any, stamp_s: float, rng: random.Random
) -> None:
    """Call a loop closer with one strange argument."""
    frame, kind = dataclasses.replace(frame, stamp_s=stamp_s), rng.randrange(5)
    if kind == 0:
        closer.process(strange_frame(frame, rng), T)
    elif kind == 1:
        closer.process(frame, strange_array(T, rng))
    elif kind == 2:
        closer.process(frame, T, strange_array(1e-4 * np.eye(6), rng))
    elif kind == 3:
        points = np.random.default_rng(0).random((300, 3)) + 1.0
        closer.process_points(stamp_s, strange_array(points, rng), T)
    else:
        closer.process(frame, T, T_view_camera=strange_array(np.eye(4), rng))


def read_recogniser(place: Path, case: Path) -> None:
    """Add strange views to a recogniser and a localiser; they go on and answer."""
    rng = random.Random(json.loads((case / "seed.json").read_text()))
    verifier = registry.build("verifiers", "projective")
    recogniser, localizer = PlaceRecogniser(), Localizer(verifier)
    for k in range(4):
        frame, T = good(k)
        kind = rng.randrange(4)
        with refusals():
            recogniser.add(
                strange_frame(frame, rng) if kind == 0 else frame,
                strange_array(T, rng) if kind == 1 else T,
            )
        with refusals():
            localizer.add(
                strange_frame(frame, rng) if kind == 2 else frame,
                strange_array(T, rng) if kind == 3 else T,
            )
    query = recogniser.add(*good(4))
    with refusals():
        recogniser.recognise(rng.randrange(-3, 9), rng.randrange(-3, 9))
    for match in recogniser.recognise(query, query):
        expect_numbers(match, "match")
    with refusals():
        localizer.localize(strange_frame(good(5)[0], rng))
    answer = localizer.localize(good(5)[0])
    if answer.is_known:
        expect_numbers(answer.T_map_camera, "T_map_camera")


READERS = {
    "value": Reader(10, nothing, mutate_call, read_value),
    "closer": Reader(0.4, nothing, mutate_call, read_closer),
    "recogniser": Reader(0.2, nothing, mutate_call, read_recogniser),
}
