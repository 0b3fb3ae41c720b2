"""Loop candidates: older keyframes that may show the same place as the newest one.

They are proposed by depth views (``ViewLoopDetector``) or by bags of words, as in the paper
(``BagLoopDetector``). In both cases the best ones are checked for contradicting scene labels and
for time consistency (``CandidateChecks``). Open candidates are verified by geometry. Candidates
above the upper threshold are accepted, and geometry only measures their relative pose.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Protocol

from numpy.typing import ArrayLike

from slam_bof.loops.bag_detector import BagLoopDetector
from slam_bof.loops.candidate_checks import LoopCounts, RankedCandidates
from slam_bof.loops.params import LoopParams
from slam_bof.loops.view_detector import ViewLoopDetector
from slam_bof.places import Compare
from slam_bof.types import Candidate, DepthFrame, Keyframe, Loop, SavedConstellation

__all__ = ["LoopDetector", "make_loop_detector"]


class LoopDetector(Protocol):
    """Finds the older keyframes that may show the same place as each new keyframe."""

    @property
    def compare(self) -> Compare | None:
        """Measures the agreement of a keyframe with others at given poses; None with bags."""

    @property
    def counts(self) -> LoopCounts:
        """Numbers of keyframes of this session by the stage that their search reached."""

    @property
    def newest(self) -> SavedConstellation | None:
        """The constellation of the keyframe stored last, None with bags."""

    def find(self, keyframe: Keyframe, frame: DepthFrame) -> RankedCandidates:
        """Return the candidates of a keyframe, and store it."""

    def remember(
        self,
        keyframe: Keyframe,
        frame: DepthFrame,
        candidates: Sequence[Candidate],
        constellation: SavedConstellation | None = None,
    ) -> None:
        """Store a keyframe without a search, with what was found of it before."""

    def on_loops_accepted(self, loops: Sequence[Loop]) -> None:
        """Take note of new edges, some of which may be loops of the newest keyframe."""

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Remove keyframes from all later searches."""

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Prepare for keyframes with another odometry frame and its rough gravity (3,)."""

    def state(self) -> dict[str, Any]:
        """Return the state that keyframes and candidates do not contain, as JSON values."""

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state, after its keyframes were stored."""


def make_loop_detector(
    params: LoopParams,
    n_words: int,
    *,
    gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
    seed: int = 0,
) -> LoopDetector:
    """Return the detector that ``params.by`` names.

    Parameters
    ----------
    params
        Parameters of the search.
    n_words
        Number of words of the vocabulary, for bags.
    gravity_odom
        (3,) rough direction of gravity in the odometry frame, for views.
    seed
        Seed of the random samples that alignment draws, for views.
    """
    if params.by == "bags":
        return BagLoopDetector(params, n_words)
    return ViewLoopDetector(params, gravity_odom=gravity_odom, seed=seed)
