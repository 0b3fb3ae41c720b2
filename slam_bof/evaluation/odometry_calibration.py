"""Whether depth images and an odometry of another sensor fit: clock, unit of length and axes.

The motion between two frames is known twice, from alignment of their depth and from odometry. If
the clocks differ, odometry turns earlier or later than depth; if the scale of depth is wrong,
distances differ in proportion; and if the axes differ, so do the directions of all motions.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from slam_bof.geometry import AlignmentParams, ViewAligner, make_view, open_directions, se3
from slam_bof.types import Array, DepthFrame, Pose, Trajectory

__all__ = ["Calibration", "FrameMotion", "calibrate", "measure_motions"]

BASELINES = ((0.1, 0.15), (0.4, 0.5))
"""Motions are measured over about this turn in rad or shift in m. Short ones determine the time
offset, long ones the scale."""
MAX_GAP_S = 0.15
"""Poses of odometry farther apart than this do not determine the time offset."""
MIN_AGREEMENT = 0.6
"""Smallest share of inliers among the points that can be compared, at which an alignment counts."""
MIN_VISIBLE_RATIO = 0.3
"""Smallest share of points that can be compared."""
MAX_OFFSET_S = 0.2
"""Largest difference of clocks that is looked for."""
STARTS_S = (-0.1, 0.0, 0.1)
"""Differences of clocks at which the fit starts, since it finds the nearest minimum only."""
MIN_MOTIONS = 20
"""Least number of motions, to which five unknowns are fitted."""


class FrameMotion(NamedTuple):
    """The pose ``T_a_b`` (4, 4) of a frame in an earlier one, by alignment, and their times.

    ``is_held`` says whether the surfaces hold all directions.
    """

    stamp_a_s: float
    stamp_b_s: float
    T_a_b: Pose
    is_held: bool


class Calibration(NamedTuple):
    """The differences between odometry and depth, each with its standard deviation.

    ``time_offset_s`` is added to the stamps of depth images to get odometry's clock; its standard
    deviation is infinite if the poses of odometry are too far apart to measure it.
    ``depth_scale`` multiplies depth to get odometry's unit of length. ``tilt_rad`` (3,) is the
    rotation vector that takes odometry's axes to those of the depth camera.
    """

    time_offset_s: float
    time_offset_sigma_s: float
    depth_scale: float
    depth_scale_sigma: float
    tilt_rad: Array
    tilt_sigma_rad: Array
    n_motions: int


def measure_motions(
    visits: Iterable[tuple[DepthFrame, Pose]], *, seed: int = 0
) -> list[FrameMotion]:
    """Align each frame with an earlier one, starting from its pose (4, 4) by odometry.

    A frame whose pose is NaN is passed over.
    """
    chains = [_MotionChain(*baseline, seed) for baseline in BASELINES]
    for frame, T_odom_camera in visits:
        if np.isfinite(T_odom_camera).all():
            for chain in chains:
                chain.add(frame, T_odom_camera)
    return [motion for chain in chains for motion in chain.motions]


class _MotionChain:
    """Motions over at least a turn or a shift, each from where the last one ended."""

    def __init__(self, turn_rad: float, shift_m: float, seed: int) -> None:
        params = AlignmentParams(n_points=1000, n_iterations=8, gates_m=(0.15, 0.03))
        self.motions: list[FrameMotion] = []
        self._turn_rad, self._shift_m = turn_rad, shift_m
        self._aligner = ViewAligner(params, seed=seed)
        self._stamp_s, self._T_odom_camera = 0.0, np.eye(4)

    def add(self, frame: DepthFrame, T_odom_camera: Pose) -> None:
        if len(self._aligner):
            start = se3.inverse(self._T_odom_camera) @ T_odom_camera
            shift_m = np.linalg.norm(start[:3, 3])
            if se3.rotation_angle(start) < self._turn_rad and shift_m < self._shift_m:
                return
            self._aligner.add(make_view(frame))
            self._measure(frame.stamp_s, start)
            self._aligner.truncate(0)
        self._aligner.add(make_view(frame))
        self._stamp_s, self._T_odom_camera = frame.stamp_s, T_odom_camera

    def _measure(self, stamp_s: float, start: Pose) -> None:
        match = np.array([0])
        T = self._aligner.refine(1, match, start[None])
        directions = open_directions(self._aligner, 1, 0, T[0])
        found = self._aligner.agreement(1, match, T)
        is_seen = found.visible_ratio[0] >= MIN_VISIBLE_RATIO
        if directions is None or not is_seen:
            return
        if found.inlier_ratio[0] < MIN_AGREEMENT * found.visible_ratio[0]:
            return
        is_held = directions[1].shape[1] == 0
        self.motions.append(FrameMotion(self._stamp_s, stamp_s, T[0], is_held))


def calibrate(motions: list[FrameMotion], odometry: Trajectory) -> Calibration | None:
    """Estimate the differences between depth and odometry; None if there is too little motion.

    Robust least squares over clock, scale and axes at once, from several starts.
    """
    known = np.isfinite(odometry.poses).all(axis=(1, 2))
    odometry = Trajectory(odometry.stamps_s[known], odometry.poses[known])
    if len(odometry) < 2:
        return None
    early, late = odometry.stamps_s[[0, -1]] + [MAX_OFFSET_S, -MAX_OFFSET_S]
    motions = [m for m in motions if early <= m.stamp_a_s and m.stamp_b_s <= late]
    if len(motions) < MIN_MOTIONS or sum(m.is_held for m in motions) < MIN_MOTIONS:
        return None
    compared = _ComparedMotions(motions, odometry)
    has_clock = np.median(np.diff(odometry.stamps_s)) <= MAX_GAP_S
    max_offset_s = MAX_OFFSET_S if has_clock else 1e-9
    sigmas = [_spread(off) for off in compared.differences(np.zeros(5))]
    for _ in range(2):
        fits = [
            least_squares(
                compared.residuals,
                np.array([0.0, 0.0, 0.0, start_s, 0.0]),
                args=(sigmas,),
                loss="soft_l1",
                x_scale=(0.01, 0.01, 0.01, 0.01, 0.01),
                bounds=([-0.5] * 3 + [-max_offset_s, -0.5], [0.5] * 3 + [max_offset_s, 0.5]),
            )
            for start_s in (STARTS_S if has_clock else (0.0,))
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        sigmas = [_spread(off) for off in compared.differences(best.x)]
    sigma = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac)))
    scale = float(np.exp(best.x[4]))
    return Calibration(
        time_offset_s=float(best.x[3]),
        time_offset_sigma_s=float(sigma[3]) if has_clock else float("inf"),
        depth_scale=scale,
        depth_scale_sigma=scale * float(sigma[4]),
        tilt_rad=best.x[:3],
        tilt_sigma_rad=sigma[:3],
        n_motions=len(motions),
    )


class _ComparedMotions:
    """Motions by alignment beside those of odometry.

    The differences depend on x (5,): the tilt as a rotation vector, the offset of the clock in s,
    and the logarithm of the scale.
    """

    def __init__(self, motions: list[FrameMotion], odometry: Trajectory) -> None:
        aligned = np.array([m.T_a_b for m in motions])
        self._turns = Rotation.from_matrix(aligned[:, :3, :3]).as_rotvec()
        self._shifts = aligned[:, :3, 3]
        self._is_held = np.array([m.is_held for m in motions], np.bool_)
        self._stamps_s = np.array([[m.stamp_a_s, m.stamp_b_s] for m in motions])
        self._odometry = odometry
        self._rotation = Slerp(odometry.stamps_s, Rotation.from_matrix(odometry.poses[:, :3, :3]))

    def differences(self, x: Array) -> tuple[Array, Array]:
        """Return the differences of turns (M, 3) and, where all directions are held, of shifts."""
        T_a, T_b = (
            _poses_at(self._odometry, self._rotation, stamps + x[3]) for stamps in self._stamps_s.T
        )
        motion, tilt = se3.inverse(T_a) @ T_b, Rotation.from_rotvec(x[:3])
        turned = tilt.apply(Rotation.from_matrix(motion[:, :3, :3]).as_rotvec())
        shifted = tilt.apply(motion[:, :3, 3])
        # Noise is in the alignment, which would make the scale too small as its factor.
        return self._turns - turned, (self._shifts - np.exp(-x[4]) * shifted)[self._is_held]

    def residuals(self, x: Array, sigmas: list[float]) -> Array:
        """Return all differences, each divided by its standard deviation."""
        pairs = zip(self.differences(x), sigmas, strict=True)
        return np.concatenate([(off / sigma).ravel() for off, sigma in pairs])


def _poses_at(odometry: Trajectory, rotation: Slerp, stamps_s: Array) -> Array:
    """Return interpolated poses (M, 4, 4) at times (M,) within the trajectory."""
    T = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    T[:, :3, :3] = rotation(stamps_s).as_matrix()
    for axis in range(3):
        T[:, axis, 3] = np.interp(stamps_s, odometry.stamps_s, odometry.poses[:, axis, 3])
    return T


def _spread(differences: Array) -> float:
    """Return a robust standard deviation, from the median."""
    return max(1.4826 * float(np.median(np.abs(differences))), 1e-6)
