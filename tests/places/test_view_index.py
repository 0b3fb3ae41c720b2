import numpy as np
import pytest

from slam_bof.bof import ConstellationParams, IndexParams, index_view, place_bofs
from slam_bof.places.view_index import ViewIndex

N = 30


def scene(seed):
    """Points (N, 3) in the levelled frame of a few walls and boxes."""
    random = np.random.default_rng(seed)
    boxes = []
    for _ in range(6):
        size = random.uniform(0.2, 1.5, 3)
        place = random.uniform((-1.5, -0.8, 1.2), (1.5, 0.8, 4.0))
        boxes.append(random.uniform(-0.5, 0.5, (3000, 3)) * size + place)
    return np.concatenate(boxes).astype(np.float32)


def hold(index, ids):
    for view_id in ids:
        index.add(view_id, index_view(place_bofs(scene(view_id % N), ConstellationParams())))


@pytest.fixture
def index():
    index = ViewIndex(IndexParams(), ConstellationParams())
    hold(index, range(0, 2 * N, 2))  # the others are not searched
    return index


def test_the_same_scene_is_proposed_first_without_motion():
    index = ViewIndex(IndexParams(n_compared=10), ConstellationParams())
    hold(index, [*range(0, N), N + 7])
    found = index.propose(N + 7, N)
    assert found.view_ids[0] == 7
    assert abs(found.motions.yaw[0]) + abs(found.motions.shift[0]) < 0.02


def test_a_view_is_proposed_with_several_motions_and_with_turns_on_the_spot():
    index = ViewIndex(IndexParams(n_compared=10), ConstellationParams())
    hold(index, [*range(0, N), N + 7])
    ids, motions = index.propose(N + 7, N)
    assert len(ids) == len(motions.yaw) == len(motions.shift) == len(motions.height)
    of_one = np.flatnonzero(ids == ids[1])
    assert len(of_one) == IndexParams().matching.max_hypotheses + 3
    still = np.abs(motions.shift[of_one]) + np.abs(motions.height[of_one]) == 0.0
    assert np.degrees(motions.yaw[of_one[still]]) == pytest.approx([-12.0, 0.0, 12.0])
    assert len(np.unique(motions.shift[of_one[~still]])) == 3


def test_only_views_below_and_not_left_out_are_proposed(index):
    found = index.propose(58, 40, exclude=np.array([4, 6]))
    assert set(found.view_ids.tolist()) == set(range(0, 40, 2)) - {4, 6}
    assert len(index.propose(58, 0).view_ids) == 0


def test_a_dropped_view_is_gone(index):
    before = index.nbytes
    hold(index, [77])
    assert index.nbytes > before
    index.pop()
    assert index.nbytes == before
    assert 77 not in index.propose(58, 100).view_ids


def test_views_around_one_are_those_that_are_searched(index):
    assert index.neighbours(10, 2, 100) == [6, 8, 10, 12, 14]
    assert index.neighbours(0, 1, 100) == [0, 2]
    assert index.neighbours(10, 2, 11) == [6, 8, 10]
    assert index.neighbours(11, 1, 100) == [10, 12, 14]


def test_removed_views_are_gone_and_the_others_keep_their_ids(index):
    before = index.nbytes
    index.remove([4, 5, 10])
    assert index.nbytes < before
    assert index.neighbours(8, 2, 100) == [2, 6, 8, 12, 14]
    found = index.propose(58, 40)
    assert set(found.view_ids.tolist()) == set(range(0, 40, 2)) - {4, 10}
    hold(index, [2 * N + 12])
    assert index.propose(2 * N + 12, 2 * N).view_ids[0] == 12
