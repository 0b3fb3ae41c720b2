"""Localisation of a single depth image in a finished map.

Similar keyframes propose poses (``recogniser``), which a verifier refines. A pose is accepted if
the keyframes around it together cover nearly all of the image and do not contradict it: at a
wrong pose, part of the image has no counterpart in the map or violates its free space. If two
places are consistent with the image, no pose is returned, since rooms can be identical.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from slam_bof.core import GrowingArray, one_blas_thread
from slam_bof.geometry import se3, view_points
from slam_bof.places.map_consistency import KnownView, MapConsistency, MapConsistencyParams
from slam_bof.places.params import RecogniserParams
from slam_bof.places.perceptual_aliasing import PerceptualAliases, PerceptualAliasParams
from slam_bof.places.pose_hypotheses import (
    HypothesisRegistration,
    PoseHypothesis,
    are_near,
    group_hypotheses,
    mean_pose,
)
from slam_bof.places.recogniser import PlaceMatch, PlaceRecogniser
from slam_bof.ports import Verifier
from slam_bof.types import DepthFrame, Params, Pose, SavedConstellation, SensorParams

__all__ = ["Localization", "LocalizationParams", "Localizer"]


class LocalizationParams(Params):
    """Parameters of localisation: the search for poses and the conditions for accepting one."""

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
    """The pose of a frame in the map, or the reason why it is unknown.

    ``T_map_camera`` is None if the pose is unknown; then ``reason`` says why, otherwise it is
    empty. ``keyframe_id`` is the keyframe that matches best, and ``overlap`` and ``rmse_m`` are
    those of its ``Verification``. ``supporting_ids`` are the other keyframes that lead to the same
    pose.
    """

    T_map_camera: Pose | None = None
    keyframe_id: int | None = None
    overlap: float = float("nan")
    rmse_m: float = float("nan")
    supporting_ids: tuple[int, ...] = ()
    reason: str = ""

    @property
    def is_known(self) -> bool:
        """Whether the pose is known."""
        return self.T_map_camera is not None


class _Query(NamedTuple):
    """A frame to localise: its view in the recogniser, and its data prepared by the verifier."""

    view: KnownView
    prepared: Any


class Localizer:
    """Stores the keyframes of a finished map and localises single frames in it.

    Parameters
    ----------
    verifier
        Registers frames. It should be a ``ports.ForgettingVerifier``; any other keeps the prepared
        data of every frame that is localised.
    params, recogniser_params
        Parameters of localisation and of place recognition.
    sensor
        Range of the depth sensor.
    gravity_odom
        (3,) rough direction of gravity in the frame of ``T_odom_camera``.
    seed
        Seed of the random samples that alignment draws.

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
        sensor: SensorParams | None = None,
        gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
        seed: int = 0,
    ) -> None:
        self.params = params or LocalizationParams()
        self._sensor = sensor or SensorParams()
        self._lock = threading.Lock()
        self._recogniser = PlaceRecogniser(
            recogniser_params, gravity_odom=gravity_odom, seed=seed, never_lost=True
        )
        self._T_map_camera = GrowingArray((4, 4), np.float64)
        self._registration = HypothesisRegistration(verifier, self._T_map_camera)
        self._consistency = MapConsistency(
            self._recogniser,
            self._T_map_camera,
            self.params.consistency,
            max_depth_m=self._sensor.max_depth_m,
        )
        self._aliases = PerceptualAliases(
            self._recogniser,
            self._registration,
            self._consistency,
            self._T_map_camera,
            self.params.aliases,
        )

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self._T_map_camera)

    def add(
        self,
        frame: DepthFrame,
        T_map_camera: Pose,
        T_odom_camera: Pose | None = None,
        *,
        name: int | None = None,
        constellation: SavedConstellation | None = None,
    ) -> int:
        """Add the next keyframe, and return its id: 0, 1, 2 ...

        Of an image 640 pixels wide only every fourth pixel is used; the others may be missing.

        Parameters
        ----------
        frame
            Frame of the same camera as the keyframes before.
        T_map_camera
            (4, 4) pose of the keyframe in the map.
        T_odom_camera
            (4, 4) pose of the keyframe by odometry, which is used to track the direction of
            gravity. The default is ``T_map_camera``.
        name
            The id that answers give for the keyframe, by default the one that is returned.
        constellation
            What the map has saved of the keyframe, so that it is not described again.

        Raises
        ------
        ValueError
            If the frame is of another camera, or a pose is not a rigid transform.
        """
        T_odom_camera = se3.checked_pose(T_map_camera if T_odom_camera is None else T_odom_camera)
        T_map_camera = se3.checked_pose(T_map_camera)
        frame = frame.with_sensor(self._sensor)
        with self._lock:
            keyframe_id = self._recogniser.add(frame, T_odom_camera, constellation)
            self._registration.add(frame, keyframe_id if name is None else name)
            self._T_map_camera.append(T_map_camera)
        return keyframe_id

    @one_blas_thread()
    def localize(
        self, frame: DepthFrame, *, gravity_camera: ArrayLike | None = None
    ) -> Localization:
        """Localise a single frame. The frame is not stored. Calls of threads wait for each other.

        Parameters
        ----------
        frame
            Frame of the same camera as the keyframes.
        gravity_camera
            (3,) direction of gravity in the camera frame, such as that of an inertial sensor. If
            it is not given, the tilt of the camera must be within about 40 degrees of that of the
            keyframes.

        Raises
        ------
        ValueError
            If the frame is of another camera.
        """
        with self._lock:  # the query is among the views for that time
            return self._localize(frame.with_sensor(self._sensor), gravity_camera)

    def _localize(self, frame: DepthFrame, gravity_camera: ArrayLike | None) -> Localization:
        """Localise a frame."""
        if len(self) == 0:
            return Localization(reason="the map has no keyframes")
        n_points = len(view_points(frame))
        if n_points < self.params.min_points:
            return Localization(
                reason=f"the image shows too little: it has {n_points} points, expected at least "
                f"{self.params.min_points}"
            )
        with (
            self._recogniser.temporary_query(frame, gravity_camera=gravity_camera) as view_id,
            self._registration.temporary_query(frame) as prepared,
        ):
            query = _Query(self._consistency.known_view(view_id, frame.intrinsics), prepared)
            matches = self._recogniser.recognise(view_id, len(self), follow=False)
            return self._select_pose(query, matches[: self.params.n_verified])

    def _select_pose(self, query: _Query, matches: Sequence[PlaceMatch]) -> Localization:
        """Verify recognised matches, and return the only pose consistent with the map, if any."""
        p, names = self.params, self._registration.names
        ids = [match.view_id for match in matches]
        guesses = np.array([match.T_match_query for match in matches])
        hypotheses, rejection = self._registration.register(query.prepared, ids, guesses)
        if not hypotheses:
            details = f"; the most similar is {rejection}" if rejection else ""
            return Localization(reason=f"no keyframe matches{details}")
        places = group_hypotheses(hypotheses, p.same_m, p.same_rad)
        consistent, reason = self._consistent_places(query, places)
        if not consistent:
            # A distant keyframe may give an inaccurate pose; those near the pose are more accurate.
            nearer = [h for place in places[:2] for h in self._register_nearest(query, place[0])]
            places = group_hypotheses(nearer, p.same_m, p.same_rad)
            consistent, _ = self._consistent_places(query, places)
        if not consistent:
            return Localization(reason=reason)
        if len(consistent) > 1:
            a, b = (names[place[0].keyframe_id] for place in consistent[:2])
            return Localization(
                reason=f"{len(consistent)} places match the image, such as keyframes {a} and {b}"
            )
        (place,) = consistent
        best = max(place, key=lambda hypothesis: hypothesis.verified.overlap)
        ambiguity = self._aliases.reason_against(query.view, best.T_map_view)
        if ambiguity:
            return Localization(reason=ambiguity)
        T_map_view = self._refine(query, best)
        if self._consistency.contradicts(query.view, T_map_view):
            return Localization(
                reason=f"keyframe {names[best.keyframe_id]} matches, but at the refined pose the "
                "free space of the map or of the image is violated"
            )
        return Localization(
            T_map_view,
            names[best.keyframe_id],
            best.verified.overlap,
            best.verified.rmse_m,
            tuple(sorted(names[h.keyframe_id] for h in place if h is not best)),
        )

    def _consistent_places(
        self, query: _Query, places: Sequence[list[PoseHypothesis]]
    ) -> tuple[list[list[PoseHypothesis]], str]:
        """Return the places consistent with the map, and why the first of the others is not."""
        p = self.params
        consistent: list[list[PoseHypothesis]] = []
        first_reason = ""
        for place in places:
            T = place[0].T_map_view
            reason = self._consistency.reason_against(query.view, T)
            if reason and not first_reason:
                name = self._registration.names[place[0].keyframe_id]
                first_reason = f"keyframe {name} matches, but {reason}"
            if reason or any(
                are_near(T, other[0].T_map_view, p.apart_m, p.apart_rad) for other in consistent
            ):
                continue
            consistent.append(place)
        return consistent, first_reason

    def _register_nearest(self, query: _Query, hypothesis: PoseHypothesis) -> list[PoseHypothesis]:
        """Register the query with the keyframes nearest to a pose hypothesis."""
        nearest = self._consistency.nearest(
            query.view, hypothesis.T_map_view, self.params.n_refined
        )
        T_near_query = se3.inverse(self._T_map_camera.rows[nearest]) @ hypothesis.T_map_view
        return self._registration.register(query.prepared, nearest.tolist(), T_near_query)[0]

    def _refine(self, query: _Query, best: PoseHypothesis) -> Pose:
        """Return the mean pose of the registrations with the nearest keyframes."""
        p, T = self.params, best.T_map_view
        nearest = self._register_nearest(query, best)
        return mean_pose(T, [h for h in nearest if are_near(T, h.T_map_view, p.same_m, p.same_rad)])
