"""Pose hypotheses of a view in the map, from its registration with keyframes."""

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
    """The pose of a view in the map according to its registration with one keyframe."""

    keyframe_id: int
    T_map_view: Pose
    verified: Verification


class HypothesisRegistration:
    """Stores the keyframes of a map, prepared by a verifier, and registers views with them.

    Parameters
    ----------
    verifier
        Registers views.
    T_map_camera
        Poses (K, 4, 4) of the keyframes.
    """

    def __init__(self, verifier: Verifier, T_map_camera: GrowingArray) -> None:
        self._verifier = verifier
        self._T_map_camera = T_map_camera
        self._prepared: list[Any] = []
        self.names: list[int] = []
        """Names of the keyframes in answers: their ids in the map."""

    def add(self, frame: DepthFrame, name: int) -> None:
        """Add the next keyframe."""
        self._prepared.append(self._prepare(frame))
        self.names.append(name)

    @contextmanager
    def temporary_query(self, frame: DepthFrame) -> Iterator[Any]:
        """Prepare a frame for ``register``; drop the data after the block if the verifier can."""
        prepared = self._prepare(frame)
        try:
            yield prepared
        finally:
            if isinstance(self._verifier, ForgettingVerifier):
                self._verifier.forget(prepared)

    def keyframe(self, keyframe_id: int) -> Any:
        """Return the prepared data of a keyframe, as input of ``register``."""
        return self._prepared[keyframe_id]

    def register(
        self, prepared: Any, ids: Sequence[int], T_match_view: Array
    ) -> tuple[list[PoseHypothesis], str]:
        """Register a view with keyframes (n,) from initial guesses (n, 4, 4).

        Returns
        -------
        hypotheses : list of PoseHypothesis
            The accepted registrations.
        rejection : str
            Why the first of the others was rejected; empty if none was.
        """
        matches = [self._prepared[k] for k in ids]
        verified = self._verifier.verify(prepared, matches, T_match_query=T_match_view)
        hypotheses, rejection = [], ""
        for k, verification in zip(ids, verified, strict=True):
            if verification.accepted:
                T_map_view = self._T_map_camera.rows[k] @ verification.T_match_query
                hypotheses.append(PoseHypothesis(k, T_map_view, verification))
            else:
                rejection = rejection or f"keyframe {self.names[k]}: {verification.reason}"
        return hypotheses, rejection

    def _prepare(self, frame: DepthFrame) -> Any:
        return self._verifier.prepare(frame, view_points(frame).astype(np.float64))


def are_near(T_map_a: Pose, T_map_b: Pose, distance_m: float, angle_rad: float) -> bool:
    """Return whether two poses differ by less than a distance (m) and an angle (rad)."""
    T_a_b = se3.inverse(T_map_a) @ T_map_b
    return bool(np.linalg.norm(T_a_b[:3, 3]) < distance_m and se3.rotation_angle(T_a_b) < angle_rad)


def group_hypotheses(
    hypotheses: Sequence[PoseHypothesis], distance_m: float, angle_rad: float
) -> list[list[PoseHypothesis]]:
    """Group hypotheses by place, in the order of the first hypothesis of each place."""
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
    """Return the mean pose of hypotheses, weighted by information, linearised at a pose.

    Without hypotheses it is the pose itself.
    """
    if not hypotheses:
        return T_map_view
    tangents = se3.log(se3.inverse(T_map_view) @ np.array([h.T_map_view for h in hypotheses]))
    information = np.array([h.verified.information for h in hypotheses])
    weighted = (information @ tangents[..., None]).sum(axis=0)[:, 0]
    mean = np.linalg.solve(information.sum(axis=0), weighted)
    return np.asarray(T_map_view @ se3.exp(mean))
