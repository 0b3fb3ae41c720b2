"""Where in a finished map a single depth image was taken, or that it is not known.

Keyframes that look alike propose poses (``recogniser``), and a verifier makes them exact. A pose is
believed where the keyframes around it, taken together, show nearly all that the image does and
nothing that contradicts: a wrong pose leaves part of the image unexplained, or in the way. Where
two places are consistent, no pose is returned: rooms may be equal to the millimetre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from slam_bof.core import GrowingArray, one_blas_thread
from slam_bof.geometry import se3, view_points
from slam_bof.places.map_consistency import KnownView, MapConsistency, MapConsistencyParams
from slam_bof.places.perceptual_aliasing import PerceptualAliases, PerceptualAliasParams
from slam_bof.places.pose_hypotheses import (
    HypothesisRegistration,
    PoseHypothesis,
    are_near,
    group_hypotheses,
    mean_pose,
)
from slam_bof.places.recogniser import PlaceMatch, PlaceRecogniser, RecogniserParams
from slam_bof.ports import Verifier
from slam_bof.types import DepthFrame, Params, Pose

__all__ = ["Localization", "LocalizationParams", "Localizer"]


class LocalizationParams(Params):
    """What a pose must have for it to be told."""

    n_verified: int = Field(
        10,
        gt=0,
        description="Number of keyframes that are verified, best first.",
    )
    min_points: int = Field(
        100,
        ge=0,
        description="Smallest number of points that an image needs to be localised.",
    )
    same_m: float = Field(0.15, gt=0, description="Poses closer than this, in m, are one place.")
    same_rad: float = Field(
        0.1,
        gt=0,
        description="Poses whose directions differ by less than this, in rad, are one place.",
    )
    apart_m: float = Field(
        0.25,
        gt=0,
        description="Poses farther apart than this, in m, are different places.",
    )
    apart_rad: float = Field(
        0.17,
        gt=0,
        description="Poses whose directions differ by more than this, in rad, are distinct places.",
    )
    n_refined: int = Field(5, gt=0, description="Number of keyframes near the pose that refine it.")
    consistency: MapConsistencyParams = MapConsistencyParams()
    aliases: PerceptualAliasParams = PerceptualAliasParams()


@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """Where a frame was taken, or why that is not known.

    ``T_map_camera`` is None where it is not, and ``reason`` says why in words, empty if it is.
    ``keyframe_id`` is the keyframe that matches best, with ``overlap`` and ``rmse_m`` as
    ``Verification`` has them; ``witness_ids`` are the others that lead to the same pose.
    """

    T_map_camera: Pose | None = None
    keyframe_id: int | None = None
    overlap: float = float("nan")
    rmse_m: float = float("nan")
    witness_ids: tuple[int, ...] = ()
    reason: str = ""

    @property
    def is_known(self) -> bool:
        """Whether the pose is known."""
        return self.T_map_camera is not None


class _Query(NamedTuple):
    """A frame that asks, also as the verifier knows it."""

    view: KnownView
    prepared: Any


class Localizer:
    """Holds the keyframes of a finished map, and tells of single frames where they were taken.

    Parameters
    ----------
    verifier
        Aligns frames; best one that can forget (``ports.ForgettingVerifier``), else it keeps what
        it prepares of each frame that asks.
    params, recogniser_params
        What is asked of a pose, and how places are found.
    gravity_odom
        (3,) roughly down in the frame of ``T_odom_camera``.
    seed
        Of what aligning draws.

    Examples
    --------
    >>> localizer = Localizer(verifier)  # doctest: +SKIP
    >>> for frame, T_map_camera in keyframes:  # doctest: +SKIP
    ...     localizer.add(frame, T_map_camera)
    >>> found = localizer.localize(frame)  # doctest: +SKIP
    >>> print(found.T_map_camera if found.is_known else found.reason)  # doctest: +SKIP
    """

    def __init__(
        self,
        verifier: Verifier,
        params: LocalizationParams | None = None,
        *,
        recogniser_params: RecogniserParams | None = None,
        gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
        seed: int = 0,
    ) -> None:
        self.params = params or LocalizationParams()
        self._recogniser = PlaceRecogniser(
            recogniser_params, gravity_odom=gravity_odom, seed=seed, never_lost=True
        )
        self._T_map_camera = GrowingArray((4, 4), np.float64)
        self._stand = HypothesisRegistration(verifier, self._T_map_camera)
        self._map = MapConsistency(self._recogniser, self._T_map_camera, self.params.consistency)
        self._aliases = PerceptualAliases(
            self._recogniser, self._stand, self._map, self._T_map_camera, self.params.aliases
        )

    def __len__(self) -> int:
        """Return the number of keyframes held."""
        return len(self._T_map_camera)

    def add(self, frame: DepthFrame, T_map_camera: Pose, T_odom_camera: Pose | None = None) -> int:
        """Hold the next keyframe, and return its id: 0, 1, 2 ...

        Of its depth, every fourth pixel (of 640 in a row) is looked at; others may be missing.

        Parameters
        ----------
        frame
            Of the same camera as those before.
        T_map_camera
            (4, 4) its pose in the map.
        T_odom_camera
            (4, 4) its pose by odometry, that tells which way was down from one keyframe to the
            next; without, the map's is taken.

        Raises
        ------
        ValueError
            If the frame is of another camera, or a pose is no rotation and translation.
        """
        T_odom_camera = T_map_camera if T_odom_camera is None else T_odom_camera
        for T in (T_map_camera, T_odom_camera):
            se3.check_rigid(T)
        keyframe_id = self._recogniser.add(frame, T_odom_camera)
        self._stand.add(frame)
        self._T_map_camera.append(T_map_camera)
        return keyframe_id

    @one_blas_thread()
    def localize(
        self, frame: DepthFrame, *, gravity_camera: ArrayLike | None = None
    ) -> Localization:
        """Return where a frame was taken, by itself; afterwards it is forgotten.

        Parameters
        ----------
        frame
            Of the same camera as the keyframes.
        gravity_camera
            (3,) down in its camera frame, if an inertial sensor tells. Without, the camera must
            be tilted as it was in the keyframes, to within some 40 degrees.

        Raises
        ------
        ValueError
            If the frame is of another camera.
        """
        if len(self) == 0:
            return Localization(reason="the map has no keyframes")
        n_points = len(view_points(frame))
        if n_points < self.params.min_points:
            return Localization(reason=f"the image shows too little: {n_points} points")
        with (
            self._recogniser.temporary_query(frame, gravity_camera=gravity_camera) as view_id,
            self._stand.temporary_query(frame) as prepared,
        ):
            query = _Query(self._map.known_view(view_id, frame.intrinsics), prepared)
            matches = self._recogniser.recognise_alone(view_id, len(self))
            return self._judge(query, matches[: self.params.n_verified])

    def _judge(self, query: _Query, matches: Sequence[PlaceMatch]) -> Localization:
        """Verify what recognition found, and tell the one pose that fits the map, if it is one."""
        p = self.params
        ids = [match.view_id for match in matches]
        guesses = np.array([match.T_match_query for match in matches])
        hypotheses, refused = self._stand.register(query.prepared, ids, guesses)
        if not hypotheses:
            return Localization(reason=f"no keyframe shows the same: the most alike, {refused}")
        places = group_hypotheses(hypotheses, p.same_m, p.same_rad)
        consistent, against = self._consistency(query, places)
        if not consistent:
            # One keyframe may be too far to lead to the very place; those around it are nearer.
            nearer = [w for place in places[:2] for w in self._look_around(query, place[0])]
            consistent, _ = self._consistency(query, group_hypotheses(nearer, p.same_m, p.same_rad))
        if not consistent:
            return Localization(reason=against)
        if len(consistent) > 1:
            a, b = (place[0].keyframe_id for place in consistent[:2])
            return Localization(
                reason=f"{len(consistent)} places are consistent: by keyframes {a} and {b}"
            )
        (place,) = consistent
        best = max(place, key=lambda hypothesis: hypothesis.verified.overlap)
        elsewhere = self._aliases.reason_against(query.view, best.T_map_view)
        if elsewhere:
            return Localization(reason=elsewhere)
        return Localization(
            self._refine(query, best),
            best.keyframe_id,
            best.verified.overlap,
            best.verified.rmse_m,
            tuple(sorted(w.keyframe_id for w in place if w is not best)),
        )

    def _consistency(
        self, query: _Query, places: Sequence[list[PoseHypothesis]]
    ) -> tuple[list[list[PoseHypothesis]], str]:
        """Return the places that the map has nothing against, and what it has against the first."""
        p = self.params
        consistent: list[list[PoseHypothesis]] = []
        against = ""
        for place in places:
            T = place[0].T_map_view
            reason_against = self._map.reason_against(query.view, T)
            against = against or f"by keyframe {place[0].keyframe_id}, {reason_against}"
            if reason_against or any(
                are_near(T, other[0].T_map_view, p.apart_m, p.apart_rad) for other in consistent
            ):
                continue
            consistent.append(place)
        return consistent, against

    def _look_around(self, query: _Query, hypothesis: PoseHypothesis) -> list[PoseHypothesis]:
        """Return what the keyframes nearest to a pose make of it."""
        nearest = self._map.nearest(query.view, hypothesis.T_map_view, self.params.n_refined)
        T_near_query = se3.inverse(self._T_map_camera.rows[nearest]) @ hypothesis.T_map_view
        return self._stand.register(query.prepared, nearest.tolist(), T_near_query)[0]

    def _refine(self, query: _Query, best: PoseHypothesis) -> Pose:
        """Return the mean of what the nearest keyframes make of a pose."""
        p, T = self.params, best.T_map_view
        around = self._look_around(query, best)
        return mean_pose(T, [w for w in around if are_near(T, w.T_map_view, p.same_m, p.same_rad)])
