"""Place recognition from depth alone: find earlier views of the same surfaces, and their poses.

BOF descriptors of level contours vote for earlier views and relative poses, and the range panorama
is compared with those of the views with most votes (``view_index``). The best views are aligned
with the query and ranked by the surfaces that both see. The matches of the last view are
propagated by odometry and aligned as well, so that a place is not lost in a view with few features.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.bof import camera_motions, index_view, place_bofs
from slam_bof.core import GrowingArray, one_blas_thread
from slam_bof.geometry import (
    Agreement,
    GravityTracker,
    ViewAligner,
    level_frame,
    make_view,
    se3,
    view_points,
)
from slam_bof.places.followed_matches import FollowedMatches
from slam_bof.places.params import RecogniserParams
from slam_bof.places.saved_constellations import restore_constellation, save_constellation
from slam_bof.places.view_index import ViewIndex
from slam_bof.types import Array, DepthFrame, Pose, SavedConstellation

__all__ = ["Compare", "PlaceMatch", "PlaceRecogniser"]

UPRIGHT = np.array([0.0, 1.0, 0.0])
"""Direction of gravity in the frame of an upright camera."""

Compare = Callable[[int, NDArray[np.integer[Any]], Array], Agreement]
"""Measures the agreement of a view with others (n,) at poses ``T_match_query`` (n, 4, 4)."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaceMatch:
    """An earlier view aligned with the query.

    Matches are ranked by ``score``. ``inlier_ratio`` and ``free_space_violation`` are defined in
    ``slam_bof.geometry.Agreement``.
    """

    view_id: int
    score: float
    T_match_query: Pose
    inlier_ratio: float
    free_space_violation: float


@dataclass(frozen=True, slots=True, eq=False)
class Shortlist:
    """The views that are most similar to a query before alignment.

    ``scores`` (n,) are those of all views that were searched. ``view_ids`` (m,) are the best views,
    best first, and ``starts`` (m, S, 4, 4) the initial poses ``T_match_query`` of their alignment.
    """

    scores: NDArray[np.float32]
    view_ids: NDArray[np.intp]
    starts: Array


class PlaceRecogniser:
    """Stores views and recognises their places in later ones.

    Parameters
    ----------
    gravity_odom
        (3,) rough direction of gravity in the odometry frame; see ``GravityTracker``.
    seed
        Seed of the points and poses that alignment draws.
    never_lost
        Whether all poses are correct; see ``GravityTracker``.

    Attributes
    ----------
    aligner
        Stores the views by their ids, and measures how far they agree.
    newest
        The constellation of the view added last, to be saved for ``add``.

    Examples
    --------
    >>> recogniser = PlaceRecogniser()
    >>> for frame, T_odom_camera in my_odometry:  # doctest: +SKIP
    ...     view_id = recogniser.add(frame, T_odom_camera)
    ...     for match in recogniser.recognise(view_id, view_id - 20)[:1]:  # the best old view
    ...         print(match.view_id, match.inlier_ratio, match.T_match_query)
    """

    def __init__(
        self,
        params: RecogniserParams | None = None,
        *,
        gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
        seed: int = 0,
        never_lost: bool = False,
    ) -> None:
        self.params = params or RecogniserParams()
        self._gravity = GravityTracker(gravity_odom, self.params.gravity, never_lost=never_lost)
        self._never_lost = never_lost
        self._index = ViewIndex(self.params.search)
        self._R_level_camera = GrowingArray((3, 3), np.float64)
        self._followed = FollowedMatches()
        self.aligner = ViewAligner(self.params.alignment, seed=seed)
        self.newest: SavedConstellation | None = None

    def __len__(self) -> int:
        """Return the number of stored views."""
        return len(self._R_level_camera)

    @one_blas_thread()
    def add(
        self, frame: DepthFrame, T_odom_camera: Pose, saved: SavedConstellation | None = None
    ) -> int:
        """Store a view, and return its id: 0, 1, 2 ...

        A view that was ``saved`` is not described again, unless parameters have changed. It is
        levelled as it was then.

        Raises
        ------
        ValueError
            If the pose is no finite rigid transform, or the frame is of another camera.
        """
        T_odom_camera = se3.checked_pose(T_odom_camera)
        if saved is None or not self._never_lost:  # gravity is tracked on through a session
            gravity_camera = self._gravity.update(make_view(frame).known_normals(), T_odom_camera)
        if saved is not None:
            gravity_camera = saved.gravity_camera
        return self._add(frame, T_odom_camera, gravity_camera, saved)

    @contextmanager
    def temporary_query(
        self, frame: DepthFrame, *, gravity_camera: ArrayLike | None = None
    ) -> Iterator[int]:
        """Store a view without odometry for the duration of a ``with`` block.

        The block receives the id of the view for ``recognise(..., follow=False)``. It must
        not add views.

        Parameters
        ----------
        frame
            Frame of the same camera as the views.
        gravity_camera
            (3,) direction of gravity in the camera frame, such as that of an inertial sensor. By
            default it is estimated from the frame, which requires that the tilt of the camera is
            within about 40 degrees of that of the views.

        Raises
        ------
        ValueError
            If the frame is of another camera.
        """
        if gravity_camera is None:
            # The mean tilt of the stored views is the best initial guess.
            reference = self._R_level_camera.rows[:, 1].sum(axis=0) + UPRIGHT
            tracker = GravityTracker(reference, self.params.gravity, never_lost=True)
            gravity_camera = tracker.update(make_view(frame).known_normals(), np.eye(4))
        view_id = self._add(frame, np.eye(4), np.asarray(gravity_camera, dtype=np.float64))
        try:
            yield view_id
        finally:
            self.deactivate()
            for store in (self.aligner, self._followed, self._R_level_camera):
                store.truncate(view_id)

    def deactivate(self) -> None:
        """Exclude the newest view from later searches, because an older one shows the same.

        The cost of a search therefore depends on the size of the place, not on the time spent.
        """
        self._index.pop()

    def remove(self, view_ids: Collection[int]) -> None:
        """Remove views for good; the ids of the others do not change."""
        self._index.remove(view_ids)
        for view_id in view_ids:
            self.aligner.drop(view_id)

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Prepare for views with another odometry frame and its rough gravity ``gravity_odom``."""
        self._gravity = GravityTracker(gravity_odom, self.params.gravity)
        self._followed.follow(0, [])

    def state(self) -> list[Any]:
        """Return the matches that are followed, as JSON values."""
        return self._followed.state()

    def restore(self, state: list[Any]) -> None:
        """Restore the matches that are followed from ``state``."""
        self._followed.restore(state)

    @property
    def nbytes(self) -> int:
        """Size of all stored views in bytes."""
        return self.aligner.nbytes + self._index.nbytes + self._R_level_camera.rows.nbytes

    @one_blas_thread()
    def recognise(
        self,
        view_id: int,
        n_views: int,
        *,
        exclude: NDArray[np.integer[Any]] | None = None,
        follow: bool = True,
    ) -> list[PlaceMatch]:
        """Return those of the first ``n_views`` views that may match this one, best first.

        The search index proposes views, and so do the matches of the last query, propagated by
        odometry. All proposals are aligned with this view and ranked.

        Parameters
        ----------
        view_id, n_views
            The query, and the number of views that are searched.
        exclude
            Ids of views that the search index leaves out.
        follow
            Whether to use the matches of the last query, and to keep the best matches of this one
            for the next query. This requires that the query was added with its odometry.

        Raises
        ------
        ValueError
            If there are no such views.
        """
        p = self.params
        if not (0 <= view_id < len(self) and 0 <= n_views <= len(self)):
            raise ValueError(
                f"found view {view_id} and {n_views} to search, expected of {len(self)} views"
            )
        shortlist = self.retrieve(view_id, n_views, exclude=exclude)
        ids, starts = shortlist.view_ids, shortlist.starts
        if follow:
            near = partial(self._index.neighbours, n=p.n_neighbours, below=n_views)
            ids, starts = self._merge(shortlist, self._followed.propose(view_id, near))
        if len(ids) == 0:
            return []
        T = self.aligner.refine(view_id, ids, self.aligner.search(view_id, ids, starts))
        inlier_ratio, free_space_violation, _ = self.aligner.agreement(view_id, ids, T)
        scores = self._score(T, inlier_ratio - free_space_violation)
        matches = [
            PlaceMatch(
                view_id=int(ids[k]),
                score=float(scores[k]),
                T_match_query=T[k],
                inlier_ratio=float(inlier_ratio[k]),
                free_space_violation=float(free_space_violation[k]),
            )
            for k in np.argsort(-scores, kind="stable")
        ]
        if follow:
            best = matches[: p.n_followed]
            self._followed.follow(view_id, [(m.view_id, m.T_match_query) for m in best])
        return matches

    @one_blas_thread()
    def retrieve(
        self, view_id: int, n_views: int, *, exclude: NDArray[np.integer[Any]] | None = None
    ) -> Shortlist:
        """Return the most similar of the first ``n_views`` views, without aligning them.

        The score is -1 for views that were not compared, are in ``exclude`` or were deactivated.
        The query itself must not be deactivated.
        """
        found = self._index.propose(view_id, n_views, self.params.n_aligned, exclude=exclude)
        R = self._R_level_camera.rows
        moved = camera_motions(found.motions, R[view_id], R[found.view_ids])
        unmoved = np.broadcast_to(np.eye(4), moved.shape)
        return Shortlist(found.scores, found.view_ids, np.stack([moved, unmoved], axis=1))

    def _merge(
        self, shortlist: Shortlist, followed: dict[int, Pose]
    ) -> tuple[NDArray[np.intp], Array]:
        """Return ``n_aligned`` views and initial poses, from the shortlist and followed matches.

        If a followed match leads to a view of the shortlist, its pose replaces the initial pose
        without motion.
        """
        ids, starts = shortlist.view_ids, shortlist.starts.copy()
        for k, listed in enumerate(ids):
            starts[k, -1] = followed.pop(int(listed), starts[k, -1])
        added = list(followed.items())[: self.params.n_aligned // 2]
        n_listed = self.params.n_aligned - len(added)
        ids = np.concatenate([ids[:n_listed], np.array([near for near, _ in added], np.intp)])
        poses = np.array([T for _, T in added]).reshape(-1, 1, 4, 4)
        poses = np.broadcast_to(poses, (len(added), *starts.shape[1:]))
        return ids, np.concatenate([starts[:n_listed], poses])

    @one_blas_thread()
    def _add(
        self,
        frame: DepthFrame,
        T_odom_camera: Pose,
        gravity_camera: Array,
        saved: SavedConstellation | None = None,
    ) -> int:
        p, R_level_camera = self.params.constellation, level_frame(gravity_camera)
        points_level = view_points(frame) @ R_level_camera.T.astype(np.float32)
        view = restore_constellation(saved, p, frame.sensor)
        if view is None:
            view = index_view(place_bofs(points_level, p))
        self.newest = save_constellation(view, gravity_camera, p, frame.sensor)
        self.aligner.add(make_view(frame))
        self._followed.add(T_odom_camera)
        self._R_level_camera.append(R_level_camera)
        self._index.add(len(self) - 1, view, points_level)
        return len(self) - 1

    def _score(self, T_match_query: Array, agreement: Array) -> Array:
        """Score by agreement up to ``overlap_saturation``; prefer near viewpoints beyond it."""
        p = self.params
        distance = np.linalg.norm(T_match_query[:, :3, 3], axis=1) / p.near_m
        angle = se3.rotation_angle(T_match_query) / np.radians(p.near_deg)
        near = np.exp(-(distance**2 + angle**2) / 2)
        excess = np.maximum(agreement - p.overlap_saturation, 0.0)
        return np.asarray(
            np.minimum(agreement, p.overlap_saturation) + 0.1 * excess + p.near_bonus * near
        )
