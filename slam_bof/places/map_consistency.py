"""Whether a view, at a pose, fits a map: what its keyframes have against it.

The keyframes around the pose, taken together, must show nearly all that the view does, and nothing
that contradicts. How nearly depends on the sensor and on the map, so both are asked: what the
keyframes come to, each judged by those around it, is no reason against it.
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


class MapConsistencyParams(Params):
    """What a view must have in common with the keyframes around its pose."""

    max_range_m: float = Field(
        8.0,
        gt=0,
        description="Depth that bounds the frustum of a view, in m.",
    )
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
        description="Largest share of these that may lie elsewhere than the map has surfaces.",
    )
    max_free_space_violation: float = Field(
        0.04,
        ge=0,
        le=1,
        description="Largest share of these that may stand before the surfaces of the map.",
    )
    max_free_space_violation_reverse: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Largest share of points of the map that may stand before the surfaces of the "
        "image.",
    )
    noise_factor: float = Field(
        2.0,
        ge=0,
        description="How many times the median shares of the map itself are added to these limits.",
    )
    max_share: float = Field(0.2, ge=0, le=1, description="Upper bound of these limits.")
    n_reference: int = Field(50, gt=0, description="Number of keyframes whose shares are measured.")


class KnownView(NamedTuple):
    """A keyframe, or a frame that asks, as the recogniser knows it."""

    view_id: int
    points_camera: Array
    """(N, 3), few."""
    camera: Intrinsics


class MapConsistency:
    """Tells what the keyframes of a map have against a view at a pose.

    Parameters
    ----------
    recogniser
        Holds the keyframes' views, and those that ask.
    T_map_camera
        Rows (K, 4, 4), the keyframes' poses; it may grow as the recogniser does.
    """

    def __init__(
        self, recogniser: PlaceRecogniser, T_map_camera: GrowingArray, params: MapConsistencyParams
    ) -> None:
        self.params = params
        self._recogniser = recogniser
        self._T_map_camera = T_map_camera
        self._limits: tuple[int, Coverage] | None = None

    def known_view(self, view_id: int, camera: Intrinsics) -> KnownView:
        """Return a view that the recogniser holds."""
        return KnownView(view_id, self._recogniser.points_camera(view_id, N_POINTS), camera)

    def overlaps(self, view: KnownView, T_map_view: Pose) -> Array:
        """Return the share of a view's points (K,) that fall into each keyframe but itself."""
        T_map_camera, far_m = self._T_map_camera.rows, self.params.max_range_m
        overlaps = view_overlap(view.points_camera, T_map_view, T_map_camera, view.camera, far_m)
        if view.view_id < len(overlaps):
            overlaps[view.view_id] = 0.0
        return overlaps

    def nearest(self, view: KnownView, T_map_view: Pose, n: int) -> NDArray[np.intp]:
        """Return up to n keyframes, other than the view, that look at most of what it shows."""
        overlaps = self.overlaps(view, T_map_view)
        near = np.argsort(-overlaps, kind="stable")[:n]
        return near[overlaps[near] >= self.params.min_near]

    def coverage(self, view: KnownView, T_map_view: Pose) -> Coverage | None:
        """Return how far a view agrees with the keyframes near a pose; None where none is."""
        near = self.nearest(view, T_map_view, self.params.max_near)
        if len(near) == 0:
            return None
        T_near_view = se3.inverse(self._T_map_camera.rows[near]) @ T_map_view
        return self._recogniser.coverage(view.view_id, near, T_near_view)

    def limits(self, camera: Intrinsics) -> Coverage:
        """Return the least that a pose needs to be compared and seen, and the most against it."""
        n = len(self._T_map_camera)
        if self._limits is None or self._limits[0] != n:
            self._limits = n, self._measure_limits(camera)
        return self._limits[1]

    def reason_against(self, view: KnownView, T_map_view: Pose) -> str:
        """Return what keyframes around a pose have against it, in words, or nothing."""
        found = self.coverage(view, T_map_view)
        if found is None:
            return "no keyframe is near"
        limits = self.limits(view.camera)
        for share, limit, words in (
            (found.visible_ratio, limits.visible_ratio, "of the image the map shows {}, below {}"),
            (found.inlier_ratio, limits.inlier_ratio, "of the image {} is as in the map, below {}"),
            (
                -found.free_space_violation,
                -limits.free_space_violation,
                "of the image {} is before the map's, above {}",
            ),
            (
                -found.free_space_violation_reverse,
                -limits.free_space_violation_reverse,
                "of the map {} is before the image's, above {}",
            ),
        ):
            if share < limit:
                return words.format(f"{abs(share):.3f}", f"{abs(limit):.3f}")
        return ""

    def contradict(self, view: KnownView, T_map_view: Pose) -> bool:
        """Tell whether a view cannot be there, be that place mapped or not."""
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
        shares = []
        for k in np.unique(np.linspace(0, len(poses) - 1, p.n_reference).astype(int)).tolist():
            found = self.coverage(self.known_view(k, camera), poses[k])
            if found is not None and found.visible_ratio >= p.min_visible_ratio:
                shares.append(
                    (
                        1.0 - found.inlier_ratio,
                        found.free_space_violation,
                        found.free_space_violation_reverse,
                    )
                )
        reference = np.median(shares, axis=0) if shares else np.zeros(3)
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
