"""Perceptual aliases: places of a map that cannot be told from other places of it.

Rooms can be identical. A view that matches one room may have been taken in the other, even where
the map has no keyframe. Each keyframe near a pose is therefore searched for in the rest of the
map. If it is found elsewhere, the same transform is applied to the pose; unless the map
contradicts the view at the transformed pose as well, the pose is ambiguous.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.core import GrowingArray
from slam_bof.geometry import se3
from slam_bof.places.map_consistency import KnownView, MapConsistency
from slam_bof.places.pose_hypotheses import HypothesisRegistration, are_near
from slam_bof.places.recogniser import PlaceRecogniser
from slam_bof.types import Array, Intrinsics, Params, Pose

__all__ = ["PerceptualAliasParams", "PerceptualAliases"]


class PerceptualAliasParams(Params):
    """Parameters of the search for perceptual aliases."""

    n_near: int = Field(
        10,
        ge=0,
        description="Number of keyframes around a pose that are searched for in the rest of the "
        "map; 0 turns the check off.",
    )
    near_m: float = Field(
        1.5,
        gt=0,
        description="Largest distance of these keyframes from the pose, in m.",
    )
    n_verified: int = Field(
        4,
        gt=0,
        description="Number of similar places that are verified for each of them.",
    )
    apart_m: float = Field(
        0.5,
        gt=0,
        description="Places closer than this, in m, count as the same.",
    )
    apart_rad: float = Field(
        0.5,
        gt=0,
        description="Places whose directions differ by less than this, in rad, count as the same.",
    )
    same_place_m: float = Field(
        1.5,
        gt=0,
        description="Keyframes closer than this, in m, may show the same place and are left out of "
        "the search.",
    )
    same_place_overlap: float = Field(
        0.3,
        gt=0,
        description="Share of points that such keyframes must see too to be left out.",
    )


class PerceptualAliases:
    """Finds keyframes of a map that match other places of it.

    Results are cached until the map grows.
    """

    def __init__(
        self,
        recogniser: PlaceRecogniser,
        registration: HypothesisRegistration,
        consistency: MapConsistency,
        T_map_camera: GrowingArray,
        params: PerceptualAliasParams,
    ) -> None:
        self.params = params
        self._recogniser = recogniser
        self._registration = registration
        self._consistency = consistency
        self._T_map_camera = T_map_camera
        self._aliases: dict[int, list[Pose]] = {}
        self._n_keyframes = 0

    def reason_against(self, view: KnownView, T_map_view: Pose) -> str:
        """Return where else in the map a view may have been taken, in words; empty if nowhere."""
        for keyframe_id in self._nearest(T_map_view).tolist():
            for T_other_map in self.aliases(keyframe_id, view.camera):
                T_other_view = T_other_map @ T_map_view
                if not self._consistency.contradicts(view, T_other_view):
                    x, y, z = T_other_view[:3, 3]
                    return (
                        f"the image may as well be from ({x:.1f}, {y:.1f}, {z:.1f}) m, "
                        f"where keyframe {self._registration.names[keyframe_id]} matches too"
                    )
        return ""

    def aliases(self, keyframe_id: int, camera: Intrinsics) -> list[Pose]:
        """Return the transforms ``T_other_map`` (4, 4) to places that match a keyframe too."""
        if self._n_keyframes != len(self._T_map_camera):
            self._n_keyframes = len(self._T_map_camera)
            self._aliases.clear()
        if keyframe_id not in self._aliases:
            self._aliases[keyframe_id] = self._find(keyframe_id, camera)
        return self._aliases[keyframe_id]

    def _nearest(self, T_map_view: Pose) -> NDArray[np.intp]:
        distance_m = self._distances_m(T_map_view)
        nearest = np.argsort(distance_m, kind="stable")[: self.params.n_near]
        return nearest[distance_m[nearest] < self.params.near_m]

    def _distances_m(self, T_map_view: Pose) -> Array:
        apart_m = self._T_map_camera.rows[:, :3, 3] - T_map_view[:3, 3]
        return np.asarray(np.linalg.norm(apart_m, axis=1))

    def _find(self, keyframe_id: int, camera: Intrinsics) -> list[Pose]:
        p = self.params
        T_map_camera = self._T_map_camera.rows[keyframe_id]
        view = self._consistency.known_view(keyframe_id, camera)
        overlaps = self._consistency.overlaps(view, T_map_camera)
        is_near = self._distances_m(T_map_camera) < p.same_place_m
        is_same = is_near & (overlaps >= p.same_place_overlap)
        is_same[keyframe_id] = True
        matches = self._recogniser.recognise(
            keyframe_id, len(is_same), exclude=np.flatnonzero(is_same), follow=False
        )[: p.n_verified]
        hypotheses, _ = self._registration.register(
            self._registration.keyframe(keyframe_id),
            [match.view_id for match in matches],
            np.array([match.T_match_query for match in matches]),
        )
        found: list[Pose] = []
        for T in (hypothesis.T_map_view for hypothesis in hypotheses):
            known = (T_map_camera, *(T_other_map @ T_map_camera for T_other_map in found))
            if any(are_near(T, other, p.apart_m, p.apart_rad) for other in known):
                continue
            if not self._consistency.reason_against(view, T):
                found.append(T @ se3.inverse(T_map_camera))
        return found
