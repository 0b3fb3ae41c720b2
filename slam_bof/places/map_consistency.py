"""Whether a view, at a pose, fits a map: what its keyframes have against it.

The keyframes around the pose, taken together, must show nearly all that the view does, and nothing
that contradicts. How nearly depends on the sensor and on the map, so both are asked: what the
keyframes come to, each judged by those around it, is no objection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.core import Stack
from slam_bof.geometry import Coverage, se3, view_overlap
from slam_bof.places.recogniser import PlaceRecogniser
from slam_bof.types import Array, Intrinsics, Params, Pose

__all__ = ["FitParams", "KnownView", "MapFit"]

N_POINTS = 200


class FitParams(Params):
    """What a view must have in common with the keyframes around its pose."""

    max_range_m: float = Field(8.0, gt=0, description="how far a view reaches")
    min_near: float = Field(0.1, gt=0, le=1, description="share of points in a near view")
    max_near: int = Field(40, gt=0, description="near views that are asked")
    min_compared: float = Field(0.5, ge=0, le=1, description="of points where the map has depth")
    max_unseen: float = Field(0.05, ge=0, le=1, description="of these, that the map has elsewhere")
    max_blocking: float = Field(0.04, ge=0, le=1, description="of these, before what the map has")
    max_blocked: float = Field(0.05, ge=0, le=1, description="of the map's, before what is seen")
    noise_factor: float = Field(
        2.0, ge=0, description="so many times the keyframes' own shares are added to these"
    )
    max_share: float = Field(0.2, ge=0, le=1, description="but none may be more than this")
    n_usual: int = Field(50, gt=0, description="keyframes whose shares are measured")


class KnownView(NamedTuple):
    """A keyframe, or a frame that asks, as the recogniser knows it."""

    view_id: int
    points_camera: Array
    """(N, 3), few."""
    camera: Intrinsics


class MapFit:
    """Tells what the keyframes of a map have against a view at a pose.

    Parameters
    ----------
    recogniser
        Holds the keyframes' views, and those that ask.
    T_map_camera
        Rows (K, 4, 4), the keyframes' poses; it may grow as the recogniser does.
    """

    def __init__(self, recogniser: PlaceRecogniser, T_map_camera: Stack, params: FitParams) -> None:
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

    def object(self, view: KnownView, T_map_view: Pose) -> str:
        """Return what keyframes around a pose have against it, in words, or nothing."""
        found = self.coverage(view, T_map_view)
        if found is None:
            return "no keyframe is near"
        limits = self.limits(view.camera)
        for share, limit, words in (
            (found.compared, limits.compared, "of the image the map shows {}, below {}"),
            (found.seen, limits.seen, "of the image {} is as in the map, below {}"),
            (-found.blocking, -limits.blocking, "of the image {} is before the map's, above {}"),
            (-found.blocked, -limits.blocked, "of the map {} is before the image's, above {}"),
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
        return found.blocking > limits.blocking or found.blocked > limits.blocked

    def _measure_limits(self, camera: Intrinsics) -> Coverage:
        p = self.params
        poses = self._T_map_camera.rows
        shares = []
        for k in np.unique(np.linspace(0, len(poses) - 1, p.n_usual).astype(int)).tolist():
            found = self.coverage(self.known_view(k, camera), poses[k])
            if found is not None and found.compared >= p.min_compared:
                shares.append((1.0 - found.seen, found.blocking, found.blocked))
        usual = np.median(shares, axis=0) if shares else np.zeros(3)
        most = np.array([p.max_unseen, p.max_blocking, p.max_blocked]) + p.noise_factor * usual
        unseen, blocking, blocked = np.minimum(most, p.max_share).tolist()
        return Coverage(p.min_compared, 1.0 - unseen, blocking, blocked)
