"""Keyframes that a view was aligned with, and the poses in the map that they lead to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from slam_bof.core import GrowingArray
from slam_bof.geometry import se3, view_points
from slam_bof.ports import ForgettingVerifier, Verifier
from slam_bof.types import Array, DepthFrame, Pose, Verification

__all__ = ["HypothesisRegistration", "PoseHypothesis", "are_near", "group_hypotheses", "mean_pose"]


class PoseHypothesis(NamedTuple):
    """A keyframe that a view was aligned with, and the pose that it leads to."""

    keyframe_id: int
    T_map_view: Pose
    verified: Verification


class HypothesisRegistration:
    """Holds a map's keyframes as a verifier knows them, and hears them about a view.

    Parameters
    ----------
    verifier
        Aligns views.
    T_map_camera
        Rows (K, 4, 4), the keyframes' poses.
    """

    def __init__(self, verifier: Verifier, T_map_camera: GrowingArray) -> None:
        self._verifier = verifier
        self._T_map_camera = T_map_camera
        self._prepared: list[Any] = []

    def add(self, frame: DepthFrame) -> None:
        """Hold the next keyframe."""
        self._prepared.append(self._prepare(frame))

    @contextmanager
    def temporary_query(self, frame: DepthFrame) -> Iterator[Any]:
        """Prepare a frame for ``register``; forget it when the block ends, if possible."""
        prepared = self._prepare(frame)
        try:
            yield prepared
        finally:
            if isinstance(self._verifier, ForgettingVerifier):
                self._verifier.forget(prepared)

    def keyframe(self, keyframe_id: int) -> Any:
        """Return a keyframe as ``register`` takes it."""
        return self._prepared[keyframe_id]

    def register(
        self, prepared: Any, ids: Sequence[int], T_match_view: Array
    ) -> tuple[list[PoseHypothesis], str]:
        """Align a view with keyframes (n,) from guesses (n, 4, 4).

        Returns
        -------
        witnesses : list of PoseHypothesis
            Those that show the same.
        refused : str
            Why the first of the others does not; empty if there is none.
        """
        matches = [self._prepared[k] for k in ids]
        verified = self._verifier.verify(prepared, matches, T_match_query=T_match_view)
        hypotheses, refused = [], ""
        for k, verification in zip(ids, verified, strict=True):
            if verification.accepted:
                T_map_view = self._T_map_camera.rows[k] @ verification.T_match_query
                hypotheses.append(PoseHypothesis(k, T_map_view, verification))
            else:
                refused = refused or f"keyframe {k}: {verification.reason}"
        return hypotheses, refused

    def _prepare(self, frame: DepthFrame) -> Any:
        return self._verifier.prepare(frame, view_points(frame).astype(np.float64))


def are_near(T_map_a: Pose, T_map_b: Pose, distance_m: float, angle_rad: float) -> bool:
    """Tell whether two poses are less than so far apart, and turned by less than so much."""
    apart = se3.inverse(T_map_a) @ T_map_b
    return bool(np.linalg.norm(apart[:3, 3]) < distance_m and se3.rotation_angle(apart) < angle_rad)


def group_hypotheses(
    hypotheses: Sequence[PoseHypothesis], distance_m: float, angle_rad: float
) -> list[list[PoseHypothesis]]:
    """Return witnesses by place, in the order of the first of each."""
    places: list[list[PoseHypothesis]] = []
    for hypothesis in hypotheses:
        for place in places:
            if are_near(place[0].T_map_view, hypothesis.T_map_view, distance_m, angle_rad):
                place.append(hypothesis)
                break
        else:
            places.append([hypothesis])
    return places


def mean_pose(T_map_view: Pose, hypotheses: Sequence[PoseHypothesis]) -> Pose:
    """Return the mean, about a pose, of those of witnesses, weighted by their information.

    Without any it is the pose itself.
    """
    if not hypotheses:
        return T_map_view
    tangents = se3.log(se3.inverse(T_map_view) @ np.array([w.T_map_view for w in hypotheses]))
    information = np.array([w.verified.information for w in hypotheses])
    weighted = (information @ tangents[..., None]).sum(axis=0)[:, 0]
    mean = np.linalg.solve(information.sum(axis=0), weighted)
    return np.asarray(T_map_view @ se3.exp(mean))
