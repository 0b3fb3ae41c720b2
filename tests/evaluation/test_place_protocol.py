import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from slam_bof.errors import DatasetError
from slam_bof.evaluation import ProtocolParams, overlap_shares
from slam_bof.evaluation.place_protocol import PlaceQueries, allowed_answers, relevant_answers
from slam_bof.evaluation.retrieval_metrics import retrieval_metrics
from slam_bof.geometry import se3
from slam_bof.types import DepthFrame, Trajectory


def turned(yaw, x=0.0):
    return se3.exp(np.array([0.0, yaw, 0.0, x, 0.0, 0.0]))


def frames_at(poses):
    return [DepthFrame(k / 30, box_room_depth_mm(CAMERA, T), CAMERA) for k, T in enumerate(poses)]


def test_only_frames_old_enough_may_answer():
    allowed = allowed_answers([0, 5, 10, 15], ProtocolParams(min_age_frames=10))
    assert np.argwhere(allowed).tolist() == [[2, 0], [3, 0], [3, 1]]


def test_a_frame_sees_all_of_itself_and_less_the_more_it_turns():
    poses = np.stack([turned(yaw) for yaw in (0.0, 0.0, 0.2, 0.5, 2.5)])
    pairs = np.zeros((5, 5), bool)
    pairs[1:, 0] = True
    shares = overlap_shares(frames_at(poses), poses, pairs, ProtocolParams())
    assert shares[1, 0] > 0.99
    assert shares[1, 0] > shares[2, 0] > shares[3, 0] > shares[4, 0] == 0.0
    assert not shares[~pairs].any()


def test_what_hides_behind_another_surface_is_not_seen():
    poses = np.stack([np.eye(4), np.eye(4)])
    frame = frames_at(poses)[0]
    hidden = DepthFrame(0.1, np.where(frame.depth > 0, 300, 0).astype(np.uint16), CAMERA)
    pairs = np.array([[False, False], [True, False]])
    assert overlap_shares([frame, hidden], poses, pairs, ProtocolParams())[1, 0] == 0.0


def test_truths_by_pose_and_by_overlap_differ():
    poses = np.stack([turned(0.0), turned(0.0, 0.35), turned(0.0, 0.1)])
    params = ProtocolParams(min_age_frames=1)
    reference = Trajectory(np.arange(3.0), poses)
    right = relevant_answers(frames_at(poses), [0, 1, 2], reference, params)
    assert np.argwhere(right["pose"]).tolist() == [[2, 0], [2, 1]]
    assert np.argwhere(right["overlap"]).tolist() == [[1, 0], [2, 0], [2, 1]]


class Turn:
    """Frames of a box room, some of them without a true pose."""

    sequence = "box/turn"

    def __init__(self, unknown):
        self.poses = np.stack([turned(0.1 * k) for k in range(6)])
        self.truth = self.poses.copy()
        self.truth[unknown] = np.nan

    def __len__(self):
        return len(self.poses)

    def frame(self, index):
        return frames_at(self.poses)[index]

    def groundtruth(self):
        return Trajectory(np.arange(6) / 30, self.truth)


def test_frames_without_a_true_pose_are_no_queries(caplog):
    queries = PlaceQueries.of(Turn([0, 1, 2]), ProtocolParams(every=1, min_age_frames=1))
    assert queries.indices == [3, 4, 5]
    assert queries.relevant["overlap"].shape == (3, 3)
    assert "box/turn: 3 of 6 frames have no true pose and are left out" in caplog.text
    with pytest.raises(DatasetError, match="found no frame with a true pose"):
        PlaceQueries.of(Turn(list(range(6))), ProtocolParams(every=1))


def literal(scores, truth, allowed, k):
    """Of the queries with a right answer, how many have one among their k best."""
    hits = []
    for row, right, may in zip(scores, truth & allowed, allowed, strict=True):
        if right.any():
            answers = sorted(np.flatnonzero(may), key=lambda j: -row[j])[:k]
            hits.append(any(right[j] for j in answers))
    return np.mean(hits)


@given(
    arrays(np.float64, (9, 9), elements=st.floats(0, 1), unique=True),
    arrays(np.bool_, (9, 9)),
)
def test_recall_equals_the_literal_one(scores, truth):
    allowed = np.tri(9, k=-2, dtype=bool)
    judged = retrieval_metrics(scores, truth, allowed, ks=(1, 3))
    if not (truth & allowed).any():
        assert judged is None
        return
    for k, recall in judged.recall_at.items():
        assert recall == pytest.approx(literal(scores, truth, allowed, k))
    assert judged.recall_at[1] <= judged.recall_at[3] <= 1.0
    assert 0.0 <= judged.average_precision <= judged.recall_at[1] + 1e-9
    assert judged.recall_at_full_precision <= judged.recall_at[1] + 1e-9


def test_full_precision_ends_at_the_first_wrong_answer():
    allowed = np.tri(5, k=-1, dtype=bool)
    truth = np.zeros((5, 5), bool)
    truth[[1, 2, 4], 0] = True
    scores = np.zeros((5, 5))
    scores[1:, 0] = [0.9, 0.8, 0.7, 0.6]  # that of query 3 is wrong
    judged = retrieval_metrics(scores, truth, allowed)
    assert judged.n_queries == 3
    assert judged.recall_at[1] == 1.0
    assert judged.recall_at_full_precision == pytest.approx(2 / 3)
    assert judged.average_precision == pytest.approx((1 + 1 + 3 / 4) / 3)
