"""Recognise places from depth alone: which earlier view shows the same surfaces, and from where.

BOFs of level contours vote for views and motions, and range panoramas are compared with the views
that have most votes (``view_index``); the best are aligned, and ranked by what both views see.
Matches of the view before are followed by odometry, and aligned as well: where a view shows too
little to be found, the place is still known from a moment ago.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slam_bof.bof import (
    ConstellationParams,
    camera_motions,
    describe_constellation,
)
from slam_bof.core import GrowingArray, one_blas_thread
from slam_bof.geometry import (
    Agreement,
    AlignmentParams,
    Coverage,
    GravityTracker,
    ViewAligner,
    make_view,
    se3,
    view_points,
)
from slam_bof.places.view_index import ViewIndex, ViewIndexParams
from slam_bof.types import Array, DepthFrame, Params, Pose

__all__ = ["Compare", "PlaceMatch", "PlaceRecogniser", "RecogniserParams"]

UPRIGHT = np.array([0.0, 1.0, 0.0])
"""Down in a camera held upright."""

Compare = Callable[[int, NDArray[np.integer[Any]], Array], Agreement]
"""Measures how far a view agrees with others (n,) at ``T_match_query`` (n, 4, 4)."""


class RecogniserParams(Params):
    """How many views each step looks at, and how alignments are ranked."""

    n_aligned: int = Field(
        20,
        ge=0,
        description="Number of views that are aligned with the query; up to half of them are "
        "followed.",
    )
    n_followed: int = Field(
        5,
        ge=0,
        description="Number of matches of the last view that are followed by odometry.",
    )
    n_neighbours: int = Field(
        2,
        ge=0,
        description="Number of views before and after such a match that are aligned too.",
    )
    overlap_saturation: float = Field(
        0.55,
        ge=0,
        description="Inlier ratio, less free-space violations, beyond which more hardly counts.",
    )
    near_bonus: float = Field(
        0.1,
        ge=0,
        description="Largest bonus in the score for a view from the same viewpoint.",
    )
    near_m: float = Field(
        0.3,
        gt=0,
        description="Distance between viewpoints at which that bonus falls off, in m.",
    )
    near_deg: float = Field(
        25.0,
        gt=0,
        description="Angle between viewpoints at which that bonus falls off, in degrees.",
    )
    constellation: ConstellationParams = ConstellationParams()
    search: ViewIndexParams = ViewIndexParams()
    alignment: AlignmentParams = AlignmentParams()


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
    """Views that agree: ``scores`` (n,) of all asked, the best ones' ids and pose hypotheses.

    ``view_ids`` (m,) are best first, ``starts`` (m, S, 4, 4) poses ``T_match_query`` to align from.
    """

    scores: NDArray[np.float32]
    view_ids: NDArray[np.intp]
    starts: Array


class PlaceRecogniser:
    """Remembers views and recognises their places.

    Parameters
    ----------
    gravity_odom
        (3,) roughly down in the odometry's frame, as ``GravityTracker`` has it.
    seed
        Of the points and the poses that alignment draws.
    never_lost
        Whether the poses are known to be right, as ``GravityTracker`` has it.

    Examples
    --------
    >>> recogniser = PlaceRecogniser()
    >>> for frame, T_odom_camera in my_odometry:  # doctest: +SKIP
    ...     view_id = recogniser.add(frame, T_odom_camera)
    ...     for match in recogniser.recognise(view_id, view_id - 20)[:1]:  # the best, of old ones
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
        self._gravity = GravityTracker(gravity_odom, never_lost=never_lost)
        self._index = ViewIndex(self.params.search)
        self._R_level_camera = GrowingArray((3, 3), np.float64)
        self._T_odom_camera = GrowingArray((4, 4), np.float64)
        self._aligner = ViewAligner(self.params.alignment, seed=seed)
        self._before: tuple[int, list[PlaceMatch]] = (0, [])

    def __len__(self) -> int:
        """Return the number of views remembered."""
        return len(self._R_level_camera)

    @one_blas_thread()
    def add(self, frame: DepthFrame, T_odom_camera: Pose) -> int:
        """Remember a view, and return its id: 0, 1, 2 ..."""
        gravity_camera = self._gravity.update(make_view(frame).known_normals(), T_odom_camera)
        return self._add(frame, T_odom_camera, gravity_camera)

    @contextmanager
    def temporary_query(
        self, frame: DepthFrame, *, gravity_camera: ArrayLike | None = None
    ) -> Iterator[int]:
        """Remember a view of which no odometry tells, and forget it when the block ends.

        The block may ask with the id that it is given (``recognise_alone``), and must not add
        views.

        Parameters
        ----------
        frame
            Of the same camera as the views.
        gravity_camera
            (3,) down in the camera's frame, as an inertial sensor has it. Without, the frame
            tells it by itself, if the camera is tilted as in the views, to within some 40 degrees.

        Raises
        ------
        ValueError
            If the frame is of another camera.
        """
        if gravity_camera is None:
            # Who looked down at a table most of the time does so again.
            reference = self._R_level_camera.rows[:, 1].sum(axis=0) + UPRIGHT
            tracker = GravityTracker(reference, never_lost=True)
            gravity_camera = tracker.update(make_view(frame).known_normals(), np.eye(4))
        view_id = self._add(frame, np.eye(4), np.asarray(gravity_camera, dtype=np.float64))
        try:
            yield view_id
        finally:
            self.deactivate()
            for held in (self._aligner, self._T_odom_camera, self._R_level_camera):
                held.truncate(view_id)

    def deactivate(self) -> None:
        """Leave the newest view out of later searches, for it shows what an older one does.

        So searches cost by how much there is to see, not by how long one has looked.
        """
        self._index.pop()

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Expect views of another odometry, down in whose frame is about ``gravity_odom`` (3,)."""
        self._gravity = GravityTracker(gravity_odom)
        self._before = (0, [])

    def state(self) -> list[Any]:
        """Return the matches that are followed, as JSON has them."""
        view_id, matches = self._before
        return [view_id, [[match.view_id, match.T_match_query.tolist()] for match in matches]]

    def restore(self, state: list[Any]) -> None:
        """Follow these matches."""
        view_id, matches = state
        self._before = (
            view_id,
            [PlaceMatch(match_id, np.nan, np.array(T), np.nan, np.nan) for match_id, T in matches],
        )

    @property
    def nbytes(self) -> int:
        """Bytes of all views remembered."""
        return self._aligner.nbytes + self._index.nbytes + self._R_level_camera.rows.nbytes

    def agreement(
        self, view_id: int, match_ids: NDArray[np.integer[Any]], T_match_query: Array
    ) -> Agreement:
        """Measure how far a view agrees with others (n,) at poses (n, 4, 4)."""
        return self._aligner.agreement(view_id, match_ids, T_match_query)

    def points_camera(self, view_id: int, n_points: int) -> Array:
        """Return ``n_points`` points (n, 3) of a view, some twice where it has fewer."""
        return self._aligner.sampled(view_id, n_points)

    def coverage(
        self, view_id: int, match_ids: NDArray[np.integer[Any]], T_match_query: Array
    ) -> Coverage:
        """Measure how far a view agrees with others (n,), taken together, at poses (n, 4, 4)."""
        return self._aligner.coverage(view_id, match_ids, T_match_query)

    def recognise(self, view_id: int, n_views: int) -> list[PlaceMatch]:
        """Return the first ``n_views`` views that may show what this one does, best first."""
        return self.rank(view_id, self.retrieve(view_id, n_views))

    def recognise_alone(
        self, view_id: int, n_views: int, *, but: NDArray[np.integer[Any]] | None = None
    ) -> list[PlaceMatch]:
        """Return what ``recognise`` does, ``but`` for some views, following no earlier matches."""
        shortlist = self.retrieve(view_id, n_views, but=but)
        return self._rank(view_id, shortlist.view_ids, shortlist.starts)

    @one_blas_thread()
    def retrieve(
        self, view_id: int, n_views: int, *, but: NDArray[np.integer[Any]] | None = None
    ) -> Shortlist:
        """Return which of the first ``n_views`` views, ``but`` for some, agree, unaligned.

        The score of those that were not compared, left out or deactivated is -1. The view that
        asks must not be deactivated.
        """
        found = self._index.propose(view_id, n_views, self.params.n_aligned, but=but)
        R = self._R_level_camera.rows
        moved = camera_motions(found.motions, R[view_id], R[found.view_ids])
        still = np.broadcast_to(np.eye(4), moved.shape)
        return Shortlist(found.scores, found.view_ids, np.stack([moved, still], axis=1))

    @one_blas_thread()
    def rank(self, view_id: int, shortlist: Shortlist) -> list[PlaceMatch]:
        """Align the view with those of a shortlist and those that it follows, and rank them.

        They are followed to the view that is ranked next.
        """
        ids, starts = self._follow(view_id, shortlist)
        matches = self._rank(view_id, ids, starts)
        if matches:
            self._before = (view_id, matches[: self.params.n_followed])
        return matches

    def _rank(self, view_id: int, ids: NDArray[np.intp], starts: Array) -> list[PlaceMatch]:
        if len(ids) == 0:
            return []
        T = self._aligner.align(view_id, ids, starts)
        inlier_ratio, free_space_violation, _ = self._aligner.agreement(view_id, ids, T)
        scores = self._score(T, inlier_ratio - free_space_violation)
        return [
            PlaceMatch(
                int(ids[k]),
                float(scores[k]),
                T[k],
                float(inlier_ratio[k]),
                float(free_space_violation[k]),
            )
            for k in np.argsort(-scores, kind="stable")
        ]

    def _follow(self, view_id: int, shortlist: Shortlist) -> tuple[NDArray[np.intp], Array]:
        """Return ``n_aligned`` views and their starts: listed, and what the last matches lead to.

        Where one leads to a view that is listed already, it replaces the start to stand still.
        """
        T_odom_camera = self._T_odom_camera.rows
        last_id, matches = self._before
        T_last_query = se3.inverse(T_odom_camera[last_id]) @ T_odom_camera[view_id]
        around = self.params.n_neighbours
        leads: dict[int, Pose] = {}
        for match in matches:
            T_match_query = match.T_match_query @ T_last_query
            T_odom_query = T_odom_camera[match.view_id] @ T_match_query
            for near in self._index.around(match.view_id, around, len(shortlist.scores)):
                leads.setdefault(near, se3.inverse(T_odom_camera[near]) @ T_odom_query)
        ids, starts = shortlist.view_ids, shortlist.starts.copy()
        for k, listed in enumerate(ids):
            starts[k, -1] = leads.pop(int(listed), starts[k, -1])
        led = list(leads.items())[: self.params.n_aligned // 2]
        n_listed = self.params.n_aligned - len(led)
        ids = np.concatenate([ids[:n_listed], np.array([near for near, _ in led], np.intp)])
        poses = np.array([T for _, T in led]).reshape(-1, 1, 4, 4)
        poses = np.broadcast_to(poses, (len(led), *starts.shape[1:]))
        return ids, np.concatenate([starts[:n_listed], poses])

    @one_blas_thread()
    def _add(self, frame: DepthFrame, T_odom_camera: Pose, gravity_camera: Array) -> int:
        described = describe_constellation(frame, gravity_camera, self.params.constellation)
        self._aligner.add(make_view(frame))
        self._T_odom_camera.append(T_odom_camera)
        self._R_level_camera.append(described.R_level_camera)
        points_level = view_points(frame) @ described.R_level_camera.T.astype(np.float32)
        self._index.add(len(self) - 1, described.bofs, points_level)
        return len(self) - 1

    def _score(self, T_match_query: Array, agreement: Array) -> Array:
        """Rank by agreement up to what is enough; beyond, by how near the views are."""
        p = self.params
        distance = np.linalg.norm(T_match_query[:, :3, 3], axis=1) / p.near_m
        angle = se3.rotation_angle(T_match_query) / np.radians(p.near_deg)
        near = np.exp(-(distance**2 + angle**2) / 2)
        more = np.maximum(agreement - p.overlap_saturation, 0.0)
        return np.asarray(
            np.minimum(agreement, p.overlap_saturation) + 0.1 * more + p.near_bonus * near
        )
