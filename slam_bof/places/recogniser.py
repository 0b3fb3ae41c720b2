"""Place recognition from depth alone: find earlier views of the same surfaces, and their poses.

BOF descriptors of level contours vote for earlier views and propose relative poses
(``view_index``). The matches of the last view, propagated by odometry, are proposed as well, so
that a place is not lost in a view with few features. The depth of few points says which proposals
are worth aligning. The aligned views are ranked by the surfaces that both see.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

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

NEARNESS = 2.0
"""Weight of ``near_bonus`` before alignment, when views agree less than they will."""

NOTHING_FOLLOWED = (np.empty(0, np.intp), np.empty((0, 4, 4)))
"""Ids and poses of views to be tried because the last query matched."""

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


class Shortlist(NamedTuple):
    """The views that are most similar to a query before alignment.

    ``view_ids`` (m,) are the best views, best first, ``T_match_query`` (m, 4, 4) the poses at which
    their alignment starts, and ``scores`` (n,) those of all views that were searched.
    """

    view_ids: NDArray[np.intp]
    T_match_query: Array
    scores: NDArray[np.float32]


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
        self._index = ViewIndex(self.params.search, self.params.constellation)
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
        odometry. The best proposals are aligned with this view and ranked.

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
        followed = NOTHING_FOLLOWED
        if follow:
            near = partial(self._index.neighbours, n=p.n_neighbours, below=n_views)
            followed = self._followed.propose(view_id, near)
        ids, starts, _ = self._shortlist(view_id, n_views, exclude, followed)
        if len(ids) == 0:
            return []
        starts = self.aligner.search(view_id, ids, starts[:, None])
        T = self.aligner.refine(view_id, ids, starts)
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
        return self._shortlist(view_id, n_views, exclude, NOTHING_FOLLOWED)

    def _shortlist(
        self,
        view_id: int,
        n_views: int,
        exclude: NDArray[np.integer[Any]] | None,
        followed: tuple[NDArray[np.intp], Array],
    ) -> Shortlist:
        """Score all proposed poses by the depth of few points, and keep the best of each view."""
        p, R = self.params, self._R_level_camera.rows
        ids, motions = self._index.propose(view_id, n_views, exclude=exclude)
        T = np.concatenate([camera_motions(motions, R[view_id], R[ids]), followed[1]])
        ids = np.append(ids, followed[0])
        bonus = NEARNESS * p.near_bonus * self._nearness(T)
        worth = self.aligner.rough_score(view_id, ids, T, bonus)
        order = np.argsort(-worth, kind="stable")
        _, first = np.unique(ids[order], return_index=True)
        best = order[np.sort(first)]
        scores = np.full(n_views, -1.0, np.float32)
        scores[ids[best]] = worth[best]
        best = best[: p.n_aligned]
        return Shortlist(ids[best], T[best], scores)

    @one_blas_thread()
    def _add(
        self,
        frame: DepthFrame,
        T_odom_camera: Pose,
        gravity_camera: Array,
        saved: SavedConstellation | None = None,
    ) -> int:
        p, R_level_camera = self.params.constellation, level_frame(gravity_camera)
        view = restore_constellation(saved, p, frame.sensor)
        if view is None:
            points_level = view_points(frame) @ R_level_camera.T.astype(np.float32)
            view = index_view(place_bofs(points_level, p))
        self.newest = save_constellation(view, gravity_camera, p, frame.sensor)
        self.aligner.add(make_view(frame))
        self._followed.add(T_odom_camera)
        self._R_level_camera.append(R_level_camera)
        self._index.add(len(self) - 1, view)
        return len(self) - 1

    def _score(self, T_match_query: Array, agreement: Array) -> Array:
        """Score by agreement up to ``overlap_saturation``; prefer near viewpoints beyond it."""
        p, near = self.params, self._nearness(T_match_query)
        excess = np.maximum(agreement - p.overlap_saturation, 0.0)
        return np.asarray(
            np.minimum(agreement, p.overlap_saturation) + 0.1 * excess + p.near_bonus * near
        )

    def _nearness(self, T_match_query: Array) -> Array:
        """Return how near viewpoints (..., 4, 4) are, from 1 for the same one down to 0."""
        p = self.params
        distance = np.linalg.norm(T_match_query[..., :3, 3], axis=-1) / p.near_m
        angle = se3.rotation_angle(T_match_query) / np.radians(p.near_deg)
        return np.asarray(np.exp(-(distance**2 + angle**2) / 2))
