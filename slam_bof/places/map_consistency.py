"""Check whether a view at a pose is consistent with the keyframes of a map.

The keyframes around the pose together must cover nearly all of the view and must not contradict
it. The limits depend on the noise of the sensor and of the map. They are therefore raised by the
deviations that the keyframes of the map show when each is compared with those around it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.core import GrowingArray
from slam_bof.geometry import Coverage, se3, view_overlap
from slam_bof.places.recogniser import PlaceRecogniser
from slam_bof.types import Array, Intrinsics, Params, Pose

__all__ = ["KnownView", "MapConsistency", "MapConsistencyParams"]

N_POINTS = 200
"""Number of points of a view that are used to find the keyframes near it."""


class MapConsistencyParams(Params):
    """Limits on the deviation of a view from the keyframes around its pose."""

    min_near: float = Field(
        0.1,
        gt=0,
        le=1,
        description="Smallest share of points that must fall into a keyframe for it to count as "
        "near.",
    )
    max_near: int = Field(
        40,
        gt=0,
        description="Largest number of near keyframes that an image is compared with.",
    )
    min_visible_ratio: float = Field(
        0.5,
        ge=0,
        le=1,
        description="Smallest share of points at which the keyframes together have a depth.",
    )
    max_outlier_ratio: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Largest share of these that may lie away from the surfaces of the map.",
    )
    max_free_space_violation: float = Field(
        0.04,
        ge=0,
        le=1,
        description="Largest share of these that may lie in front of the surfaces of the map.",
    )
    max_free_space_violation_reverse: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Largest share of points of the map that may lie in front of the surfaces of "
        "the image.",
    )
    noise_factor: float = Field(
        2.0,
        ge=0,
        description="Factor of the median shares of the map itself that are added to these limits.",
    )
    max_share: float = Field(0.2, ge=0, le=1, description="Upper bound of these limits.")
    n_reference: int = Field(50, gt=0, description="Number of keyframes whose shares are measured.")


class KnownView(NamedTuple):
    """A view stored in the recogniser: a keyframe or a temporary query."""

    view_id: int
    points_camera: Array
    """(N, 3) sample of its points."""
    camera: Intrinsics


class MapConsistency:
    """Compares a view at a pose with the keyframes of a map.

    Parameters
    ----------
    recogniser
        Stores the views of keyframes and of temporary queries.
    T_map_camera
        Poses (K, 4, 4) of the keyframes. Rows may be added together with views.
    max_depth_m
        Depth that bounds the frustum of a view.
    """

    def __init__(
        self,
        recogniser: PlaceRecogniser,
        T_map_camera: GrowingArray,
        params: MapConsistencyParams,
        *,
        max_depth_m: float,
    ) -> None:
        self.params = params
        self._max_depth_m = max_depth_m
        self._recogniser = recogniser
        self._T_map_camera = T_map_camera
        self._limits: tuple[int, Coverage] | None = None

    def known_view(self, view_id: int, camera: Intrinsics) -> KnownView:
        """Return a stored view of the recogniser."""
        return KnownView(view_id, self._recogniser.aligner.sampled(view_id, N_POINTS), camera)

    def overlaps(self, view: KnownView, T_map_view: Pose) -> Array:
        """Return the share (K,) of a view's points in each keyframe's frustum, 0 for itself."""
        T_map_camera, far_m = self._T_map_camera.rows, self._max_depth_m
        overlaps = view_overlap(view.points_camera, T_map_view, T_map_camera, view.camera, far_m)
        if view.view_id < len(overlaps):
            overlaps[view.view_id] = 0.0
        return overlaps

    def nearest(self, view: KnownView, T_map_view: Pose, n: int) -> NDArray[np.intp]:
        """Return up to ``n`` keyframes, without the view itself, with the largest overlaps."""
        overlaps = self.overlaps(view, T_map_view)
        near = np.argsort(-overlaps, kind="stable")[:n]
        return near[overlaps[near] >= self.params.min_near]

    def coverage(self, view: KnownView, T_map_view: Pose) -> Coverage | None:
        """Compare a view with all keyframes near a pose; return None if there are none."""
        near = self.nearest(view, T_map_view, self.params.max_near)
        if len(near) == 0:
            return None
        T_near_view = se3.inverse(self._T_map_camera.rows[near]) @ T_map_view
        return self._recogniser.aligner.coverage(view.view_id, near, T_near_view)

    def limits(self, camera: Intrinsics) -> Coverage:
        """Return the smallest visible and inlier ratios and the largest free-space violations."""
        n = len(self._T_map_camera)
        if self._limits is None or self._limits[0] != n:
            self._limits = n, self._measure_limits(camera)
        return self._limits[1]

    def reason_against(self, view: KnownView, T_map_view: Pose) -> str:
        """Return why a view at a pose is inconsistent with the map; empty if it is consistent."""
        found = self.coverage(view, T_map_view)
        if found is None:
            return "no keyframe is near the pose"
        limits = self.limits(view.camera)
        for ratio, min_ratio, words in (
            (found.visible_ratio, limits.visible_ratio, "of the image is covered by the map"),
            (found.inlier_ratio, limits.inlier_ratio, "of the image agrees with the map"),
        ):
            if ratio < min_ratio:
                return f"only {_percent(ratio)} {words} ({_percent(min_ratio)} needed)"
        for ratio, max_ratio, words in (
            (
                found.free_space_violation,
                limits.free_space_violation,
                "of the image lies in front of the surfaces of the map",
            ),
            (
                found.free_space_violation_reverse,
                limits.free_space_violation_reverse,
                "of the map lies in front of the surfaces of the image",
            ),
        ):
            if ratio > max_ratio:
                return f"{_percent(ratio)} {words} (at most {_percent(max_ratio)} allowed)"
        return ""

    def contradicts(self, view: KnownView, T_map_view: Pose) -> bool:
        """Return whether a view at a pose violates the free space of the map.

        Unlike ``reason_against``, this check does not require that the map covers the view.
        """
        found = self.coverage(view, T_map_view)
        if found is None:
            return False
        limits = self.limits(view.camera)
        return (
            found.free_space_violation > limits.free_space_violation
            or found.free_space_violation_reverse > limits.free_space_violation_reverse
        )

    def _measure_limits(self, camera: Intrinsics) -> Coverage:
        p = self.params
        poses = self._T_map_camera.rows
        deviations = []
        for k in np.unique(np.linspace(0, len(poses) - 1, p.n_reference).astype(int)).tolist():
            found = self.coverage(self.known_view(k, camera), poses[k])
            if found is not None and found.visible_ratio >= p.min_visible_ratio:
                deviations.append(
                    (
                        1.0 - found.inlier_ratio,
                        found.free_space_violation,
                        found.free_space_violation_reverse,
                    )
                )
        reference = np.median(deviations, axis=0) if deviations else np.zeros(3)
        most = (
            np.array(
                [
                    p.max_outlier_ratio,
                    p.max_free_space_violation,
                    p.max_free_space_violation_reverse,
                ]
            )
            + p.noise_factor * reference
        )
        outlier_ratio, free_space_violation, free_space_violation_reverse = np.minimum(
            most, p.max_share
        ).tolist()
        return Coverage(
            p.min_visible_ratio,
            1.0 - outlier_ratio,
            free_space_violation,
            free_space_violation_reverse,
        )


def _percent(ratio: float) -> str:
    return f"{100.0 * ratio:.1f} %"
