"""The contract of back-end plug-ins, as a test."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from slam_bof.geometry import se3
from slam_bof.ports import Backend, ContractingBackend
from slam_bof.testing.scenery import expect, expect_rigid
from slam_bof.types import Array, Bag, CandidateSource, EdgeKind, Keyframe, Loop

__all__ = ["check_backend"]

N = 24
"""Keyframes once round a circle of 2 m."""
EMPTY = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


def check_backend(make: Callable[[], Backend]) -> None:
    """Check that a back-end obeys its port.

    Without loops the map is the odometry; true loops reduce drift, at once and at the end; a wrong
    one among many is weighed below 0.5; ``move`` carries a part; ``set_odometry`` replaces the
    odometry; ``contract``, if there is one, removes nodes and leaves the others where they are; the
    graph is written as g2o; the same input gives the same bytes.

    Parameters
    ----------
    make
        Makes a new one: its class, if it needs no arguments.

    Raises
    ------
    AssertionError
        In words.
    """
    truth, odometry = _twice_round()
    alone = make()
    expect(isinstance(alone, Backend), "it must have all that slam_bof.ports.Backend has")
    _add(alone, odometry)
    expect(len(alone.optimize()) == 0, "without loops there are no weights")
    _expect_near(alone.poses(), odometry, 1e-4, "without loops the map must be the odometry")
    closed, again = _closed(make(), truth, odometry), _closed(make(), truth, odometry)
    expect(closed.poses().tobytes() == again.poses().tobytes(), "the same input must give the same")
    for index, T in enumerate(closed.poses()):
        expect_rigid(T, f"pose {index}")
    _check_g2o(closed)
    _check_move(make())
    _check_set_odometry(make())
    contracting = make()
    if isinstance(contracting, ContractingBackend):
        _check_contract(contracting)


def _closed(backend: Backend, truth: Array, odometry: Array) -> Backend:
    """Return the back-end with true loops and one wrong one, checked and optimised."""
    _add(backend, odometry)
    drift_m = _error_m(odometry, truth)
    for k in range(0, N, 2):
        T = se3.inverse(truth[k]) @ truth[N + k]
        backend.add_loop(Loop(N + k, k, T, 100.0 * np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW))
    backend.update()
    online_m = _error_m(backend.poses(), truth)
    expect(
        online_m < 0.7 * drift_m,
        f"update must reduce drift by true loops: {drift_m:.3f} m before, {online_m:.3f} m after",
    )
    wrong = se3.inverse(truth[1]) @ truth[N + 1] @ se3.pose(np.eye(3), [0.7, 0.0, 0.5])
    backend.add_loop(Loop(N + 1, 1, wrong, 100.0 * np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW))
    backend.update()
    weights = backend.optimize()
    expect(len(weights) == N // 2 + 1, f"a weight for each loop is expected, got {len(weights)}")
    expect(
        bool((weights[:-1] >= 0.5).all() and weights[-1] < 0.5),
        f"the wrong loop alone must weigh below 0.5, got {np.round(weights, 2).tolist()}",
    )
    after_m = _error_m(backend.poses(), truth)
    expect(after_m < 0.7 * drift_m, f"optimize must reduce drift: {drift_m:.3f} m, {after_m:.3f} m")
    _check_goes_on(backend, odometry)
    return backend


def _check_goes_on(backend: Backend, odometry: Array) -> None:
    """Add a keyframe after ``optimize``: the graph goes on from its optimum."""
    optimum = backend.poses()
    step = se3.inverse(odometry[-2]) @ odometry[-1]
    _add(backend, (odometry[-1] @ step)[None])
    _expect_near(backend.poses()[:-1], optimum, 1e-2, "after optimize the map must not jump")
    _expect_near(
        backend.poses()[-1], optimum[-1] @ step, 1e-2, "the next keyframe must follow the optimum"
    )


def _check_g2o(backend: Backend) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "graph.g2o"
        backend.write_g2o(file)
        tags = [line.split()[0] for line in file.read_text(encoding="utf-8").splitlines() if line]
    n_nodes = tags.count("VERTEX_SE3:QUAT")
    expect(n_nodes == 2 * N + 2, f"g2o must have a vertex for each keyframe, got {n_nodes}")
    expect(tags.count("EDGE_SE3:QUAT") >= 2 * N, "g2o must have the edges")


def _check_move(backend: Backend) -> None:
    """Carry the younger of two segments."""
    _, odometry = _twice_round()
    _add(backend, odometry[: N + 1])
    _add(backend, odometry[N + 1 :], segment=1)
    younger = np.arange(N + 1, 2 * N + 1)
    before = backend.poses()
    T = se3.exp(np.array([0.0, 0.5, 0.0, 1.0, 0.0, 2.0]))
    backend.move(younger, T)
    after = backend.poses()
    _expect_near(after[younger], T @ before[younger], 1e-2, "move must carry the nodes by T")
    _expect_near(after[: N + 1], before[: N + 1], 1e-2, "move must leave the other nodes alone")


def _check_set_odometry(backend: Backend) -> None:
    """Replace steps that drift by true ones, which are precise."""
    truth, odometry = _twice_round()
    _add(backend, odometry)
    loop = se3.inverse(odometry[0]) @ odometry[N]
    backend.add_loop(Loop(N, 0, loop, 100.0 * np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW))
    backend.update()
    backend.set_odometry(dict(enumerate(truth)), np.full(2, 0.01))
    backend.optimize()
    _expect_near(backend.poses(), truth, 1e-2, "precise steps must outweigh a loop")


def _check_contract(backend: ContractingBackend) -> None:
    """Contract the nodes of the second round into those of the first."""
    truth, odometry = _twice_round()
    _add(backend, odometry)
    for k in range(N):
        T = se3.inverse(truth[k]) @ truth[N + k]
        backend.add_loop(Loop(N + k, k, T, 100.0 * np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW))
    backend.update()
    backend.optimize()
    before = backend.poses()
    T_anchor_node = backend.contract({N + k: k for k in range(N)}, 12)
    stay = [*range(N), 2 * N]
    _expect_near(backend.poses(), before[stay], 1e-3, "contract must leave the other nodes alone")
    expected = se3.inverse(before[:N]) @ before[N : 2 * N]
    _expect_near(T_anchor_node, expected, 1e-3, "contract must return where the nodes go")
    weights = backend.optimize()
    expect(len(weights) == N, f"a weight for each loop ever added is expected, got {len(weights)}")
    off_m = float(np.linalg.norm((backend.poses() - before[stay])[:, :3, 3], axis=1).max())
    drift_m = _error_m(odometry, truth)
    expect(off_m < 0.3 * drift_m, f"the others must stay about where they are, off by {off_m:.3f}")


def _twice_round() -> tuple[Array, Array]:
    """Return true poses (2 N + 1, 4, 4) twice round a circle, and odometry that drifts."""
    step = se3.exp(np.array([0.0, 2 * np.pi / N, 0.0, 0.0, 0.0, 2.0 * np.pi / N]))
    drift = se3.exp(np.array([0.002, 0.004, 0.0, 0.003, -0.002, 0.003]))
    truth, odometry = [np.eye(4)], [np.eye(4)]
    for _ in range(2 * N):
        truth.append(truth[-1] @ step)
        odometry.append(odometry[-1] @ step @ drift)
    return np.array(truth), np.array(odometry)


def _add(backend: Backend, poses: Array, *, segment: int = 0) -> None:
    n_before = len(backend.poses())
    for i, T in enumerate(poses, start=n_before):
        backend.add_keyframe(Keyframe(i, i, float(i), T, EMPTY, None, segment))
        backend.update()
    expect(
        backend.poses().shape == (n_before + len(poses), 4, 4),
        f"poses must be ({n_before + len(poses)}, 4, 4), got {backend.poses().shape}",
    )


def _error_m(poses: Array, truth: Array) -> float:
    """Return the RMS distance of positions after alignment."""
    T = se3.align(truth[:, :3, 3], poses[:, :3, 3])
    off = se3.transform(T, poses[:, :3, 3]) - truth[:, :3, 3]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _expect_near(found: Array, wanted: Array, tolerance: float, message: str) -> None:
    off = float(np.abs(found - wanted).max())
    expect(off <= tolerance, f"{message}, is off by {off:.2g}")
