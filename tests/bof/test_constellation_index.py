import numpy as np
import pytest
from constellations import seen_again, view

from slam_bof.bof import (
    ConstellationIndex,
    IndexParams,
    MatchingParams,
    constellation_index,
    motion_votes,
    pack_constellation,
    unpack_constellation,
)
from slam_bof.bof.constellation import PlacedBofs
from slam_bof.bof.motion_votes import AXIS_BITS, MOTION_BITS, MotionVotes, phases
from slam_bof.bof.posting_lists import PostingLists, Postings


@pytest.fixture(scope="module")
def index():
    index = ConstellationIndex()
    assert [index.add(view(seed)) for seed in range(400)] == list(range(400))
    return index


@pytest.mark.parametrize("place", [3, 150, 399])
def test_a_view_is_found_with_its_motion(index, place):
    yaw, shift = np.radians(25.0), 0.4 - 0.3j
    # The query's frame in the match's is the inverse of how the match's contours moved.
    query = seen_again(view(place), -yaw, -shift * np.exp(-1j * yaw))
    found = index.find(query, 5)
    assert found.view_ids[0] == place
    assert found.scores[0] > 2 * found.scores[1]
    assert found.motions.yaw[0] == pytest.approx(yaw, abs=np.radians(3))
    assert found.motions.shift[0] == pytest.approx(shift, abs=0.06)
    assert found.motions.height[0] == pytest.approx(0.0, abs=0.02)


def test_contours_that_moved_otherwise_give_a_second_motion(index):
    yaws, shifts = np.radians([20.0, -15.0]), (0.5 + 0.1j, -0.4 - 0.2j)
    one, other = (
        seen_again(view(7), yaw, shift, share=1.0) for yaw, shift in zip(yaws, shifts, strict=True)
    )
    is_second = np.arange(len(one.slices)) % 3 == 2
    columns = zip(one, other, strict=True)
    query = PlacedBofs(
        *(np.where(is_second.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in columns)
    )
    found = index.compare(query, np.array([7, 8]), 2)
    assert found.view_ids.tolist() == [7, 8]
    assert found.motions.yaw[0] == pytest.approx(-yaws[0], abs=np.radians(3))
    (second,) = found.others
    assert second.yaw[0] == pytest.approx(-yaws[1], abs=np.radians(3))
    assert second.shift[0] == pytest.approx(-shifts[1] * np.exp(-1j * yaws[1]), abs=0.06)
    assert index.compare(query, np.array([7, 8])).others == ()


def test_a_single_contour_is_enough_while_votes_are_few(index, monkeypatch):
    query = seen_again(view(11), 0.1, 0.1 + 0.2j).take(slice(0, 1))
    assert 11 in index.candidates(query, 400)
    monkeypatch.setattr(motion_votes, "FEW_VOTES", 0)
    assert 11 not in index.candidates(query, 400)


def test_what_votes_leave_out_exhaustive_comparison_does_not_find_either(index):
    missed = 0
    for place in range(0, 400, 20):
        query = seen_again(view(place), 0.3, 0.2 + 0.1j, seed=place, share=0.5)
        everything = index.compare(query, np.arange(400)).view_ids[0]
        missed += index.find(query, 1).view_ids[0] != everything
    assert missed <= 1


def test_views_that_are_not_allowed_are_left_out(index):
    allowed = np.ones(400, bool)
    allowed[7] = False
    assert index.find(view(7), 1).view_ids[0] == 7
    assert 7 not in index.find(view(7), 400, allowed=allowed).view_ids


def test_the_last_view_can_be_dropped(index):
    n, n_bytes = len(index), index.nbytes
    index.add(view(1000))
    assert index.find(view(1000), 1).view_ids.tolist() == [n]
    index.pop()
    assert (len(index), index.nbytes) == (n, n_bytes)
    assert n not in index.find(view(1000), n).view_ids
    assert index.add(view(1001)) == n
    assert index.find(view(1001), 1).view_ids.tolist() == [n]
    index.pop()


def test_a_view_takes_less_than_two_kilobytes(index):
    assert index.nbytes / len(index) < 2048


def test_nothing_is_found_for_nothing_and_in_nothing(index):
    nothing = view(0).take(slice(0, 0))
    assert len(index.find(nothing, 5).view_ids) == 0
    empty = ConstellationIndex()
    assert len(empty.find(view(0), 5).view_ids) == 0
    assert empty.add(nothing) == 0
    assert len(empty.find(view(0), 5).view_ids) == 0


def test_packed_contours_are_nearly_what_they_were():
    bofs = view(5)
    rows = pack_constellation(bofs)
    assert len(rows.tobytes()) == 32 * len(bofs.slices)
    again = unpack_constellation(rows)
    np.testing.assert_array_equal(again.slices, bofs.slices)
    np.testing.assert_allclose(again.centroids_m, bofs.centroids_m, atol=0.006)
    np.testing.assert_allclose(again.log_radii, bofs.log_radii, atol=0.0101)
    np.testing.assert_allclose(again.lengths_m, bofs.lengths_m, rtol=0.016)
    np.testing.assert_allclose(again.means, bofs.means, atol=0.002)
    assert ((again.codes * bofs.codes).sum(axis=1) > 0.99).all()


def test_lists_hold_all_postings_in_order():
    lists, counts = PostingLists(n_new=3), np.random.default_rng(0).integers(0, 6, 100)
    for view_id, n in enumerate(counts.tolist()):
        keys = np.random.default_rng(view_id).integers(0, 50, n)
        told = np.full((n, 2), view_id)
        lists.add(
            Postings(
                keys.astype(np.int32),
                told[:, 0].astype(np.int32),
                told[:, 1].astype(np.int32),
                told.astype(np.uint8),
            )
        )
        held = lists.lists()
        assert all((np.diff(postings.keys) >= 0).all() for postings in held)
        views = np.concatenate([postings.views for postings in held])
        np.testing.assert_array_equal(
            np.bincount(views, minlength=100)[: view_id + 1], counts[: view_id + 1]
        )
    assert len(held) < 8
    assert all((p.views == p.places).all() for p in held)
    assert all((p.places[:, None] == p.phases).all() for p in held)


def test_views_that_are_not_kept_are_as_if_they_had_never_been_added():
    index, other = ConstellationIndex(), ConstellationIndex()
    is_kept = np.arange(200) % 3 == 0
    for seed in range(200):
        index.add(view(seed))
        if is_kept[seed]:
            other.add(view(seed))
    index.keep(is_kept)
    for one in (index, other):
        one.add(view(1000))
        one.pop()  # the newest can still be dropped
        one.add(view(1001))
    assert (len(index), index.nbytes) == (len(other), other.nbytes) == (68, other.nbytes)
    for seed in (0, 3, 4, 198, 1001):
        found, expected = index.find(view(seed), 20), other.find(view(seed), 20)
        np.testing.assert_array_equal(found.view_ids, expected.view_ids)
        np.testing.assert_array_equal(found.scores, expected.scores)


def test_common_shapes_do_not_vote_where_votes_are_many(index):
    """With a tenth of the votes, most views are found all the same; without any, none is."""
    few = ConstellationIndex(IndexParams(max_votes=400))
    none = ConstellationIndex(IndexParams(max_votes=1))
    for seed in range(400):
        few.add(view(seed))
        none.add(view(seed))
    found = 0
    for place in range(0, 400, 20):
        query = seen_again(view(place), 0.3, 0.2 + 0.1j, seed=place, share=0.8)
        candidates = few.candidates(query, 10)
        found += place in candidates
        assert len(candidates) <= len(index.candidates(query, 10))
        assert len(none.candidates(query, 10)) == 0
    assert found >= 12


@pytest.mark.parametrize(("max_views_beside", "is_found"), [(0, False), (1, True)])
def test_slices_beside_are_looked_in_while_the_map_is_small(max_views_beside, is_found):
    index = ConstellationIndex(IndexParams(max_views_beside=max_views_beside))
    index.add(view(3))
    higher = view(3)._replace(slices=view(3).slices + np.int8(1))
    (_, by_chance), (_, all_votes) = index.vote(higher, 1), index.vote(view(3), 1)
    assert (by_chance[0] > 0.5 * all_votes[0]) == is_found
    assert 0 in index.candidates(view(3), 1)


@pytest.mark.parametrize(("max_slices", "is_found"), [(2, False), (3, True)])
def test_slices_as_far_apart_as_may_match_are_looked_in(max_slices, is_found):
    index = ConstellationIndex(IndexParams(matching=MatchingParams(max_slices=max_slices)))
    index.add(view(3))
    higher = view(3)._replace(slices=view(3).slices + np.int8(3))
    (_, by_chance), (_, all_votes) = index.vote(higher, 1), index.vote(view(3), 1)
    assert (by_chance[0] > 0.5 * all_votes[0]) == is_found


def test_an_index_says_how_many_views_it_holds(monkeypatch):
    index = ConstellationIndex()
    monkeypatch.setattr(constellation_index, "MAX_VIEWS", 1)
    index.add(view(0))
    with pytest.raises(ValueError, match="at most 1 views"):
        index.add(view(1))
    assert len(index) == 1


def test_votes_are_for_the_cell_of_the_motion():
    """A contour seen again, moved by 1 m, votes for one cell; one 20 m away for none."""
    one = view(2, n=1)
    votes = MotionVotes(one)
    cells = []
    for shift in (0.0, 1.0, 20.0):
        rows = pack_constellation(one._replace(centroids_m=one.centroids_m + np.complex64(shift)))
        places = np.ascontiguousarray(rows["place"]).view(np.int32)[:, 0]
        postings = Postings(np.zeros(1, np.int32), np.array([5], np.int32), places, phases(one))
        begin, counts = np.zeros(1, np.intp), np.ones(1, np.intp)
        cells.append(votes.cells(np.zeros(1, np.intp), begin, counts, postings).tolist())
    (at_rest,), (moved,), nowhere = cells
    assert at_rest >> MOTION_BITS == moved >> MOTION_BITS == 5
    assert moved - at_rest == 2 << AXIS_BITS  # of half a metre, along x
    assert nowhere == []


def same_answers(one, other, seeds):
    for seed in seeds:
        found, expected = one.find(view(seed), 20), other.find(view(seed), 20)
        np.testing.assert_array_equal(found.view_ids, expected.view_ids)
        np.testing.assert_allclose(found.scores, expected.scores, rtol=1e-5)


def test_an_index_answers_the_same_from_its_columns_and_goes_on(index):
    whole = ConstellationIndex()
    for seed in range(120):
        whole.add(view(seed))
    columns = {name: array.copy() for name, array in whole.columns().items()}
    for array in columns.values():
        array.setflags(write=False)  # as of a file
    loaded = ConstellationIndex.load(columns)
    same_answers(loaded, whole, (0, 57, 119))
    for one in (loaded, whole):
        one.add(view(500))
        one.pop()
        assert one.add(view(501)) == 120
    same_answers(loaded, whole, (0, 501))
    nothing = ConstellationIndex.load(ConstellationIndex().columns())
    assert len(nothing) == len(nothing.find(view(0), 5).view_ids) == 0


def test_indices_are_joined_as_if_all_had_been_added_to_one():
    views = [view(seed, n=5 + seed % 7) for seed in range(90)]
    whole = ConstellationIndex()
    for bofs in views:
        whole.add(bofs)
    parts = [
        ConstellationIndex.of(
            PlacedBofs(*map(np.concatenate, zip(*some, strict=True))),
            np.array([len(bofs.slices) for bofs in some]),
        )
        for some in (views[:40], views[40:])
    ]
    joined = ConstellationIndex.joined(parts)
    assert len(joined) == 90
    for name, array in whole.columns().items():
        if name in ("rows", "starts"):
            np.testing.assert_array_equal(array, joined.columns()[name])
    same_answers(joined, whole, range(0, 90, 9))


def test_votes_in_cells_beside_count_half():
    random = np.random.default_rng(1)
    # Few cells of few views, so that many lie beside each other.
    motions = random.integers(0, 2**MOTION_BITS, 300) & 0b011_0011_0011
    cells = (random.integers(0, 4, 300) << MOTION_BITS | motions).astype(np.uint32)
    totals = random.uniform(1.0, 40.0, 5).astype(np.float32)
    votes = {int(cell): int((cells == cell).sum()) for cell in cells}
    expected = np.zeros(5)
    for cell, n_votes in votes.items():
        beside = (votes.get(cell + s * apart, 0) for s in (-1, 1) for apart in (1, 16, 256))
        view = cell >> MOTION_BITS
        worth = (n_votes + sum(beside) / 2) / np.sqrt(totals[view] + 5.0)
        expected[view] = max(expected[view], worth)
    views, worth = motion_votes.count_votes(cells, totals, 3)
    assert views.tolist() == np.argsort(-expected)[:3].tolist()
    np.testing.assert_allclose(worth, expected[views], rtol=1e-6)
    allowed = np.arange(5) != views[0]
    assert motion_votes.count_votes(cells, totals, 3, allowed)[0][:2].tolist() == views[1:].tolist()
    assert len(motion_votes.count_votes(cells[:0], totals, 3)[0]) == 0
    with pytest.raises(IndexError):
        motion_votes.count_votes(cells, totals[:3], 1)
