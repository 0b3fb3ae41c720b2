"""A map is opened by the constellations that it has saved, with the same answers as without."""

import shutil
import sqlite3
from contextlib import closing
from dataclasses import fields

import numpy as np
import pytest

from slam_bof.atlas import describe_map
from slam_bof.bof import constellation
from slam_bof.maps import MapLocalizer, MapSession, merge_maps
from slam_bof.store import MapStore, check_map
from slam_bof.store.sqlite import prepare, update_checksums

N_KEYFRAMES = 9
ANOTHER = "UPDATE constellations SET describer = 'of before'"


@pytest.fixture(scope="module")
def saved(walk, tmp_path_factory):
    """A finished map of a walk through a room."""
    return make_map(tmp_path_factory.mktemp("saved") / "map.db", walk[:N_KEYFRAMES])


@pytest.fixture
def n_described(monkeypatch):
    """Where each call of the describer is counted."""
    calls = []
    find = constellation.find_slice_contours

    def counted(*arguments):
        calls.append(1)
        return find(*arguments)

    monkeypatch.setattr(constellation, "find_slice_contours", counted)
    return calls


def make_map(path, frames):
    with MapSession.open(path) as session:
        for frame, T in frames:
            session.closer.process(frame, T)
    return path


def changed(path, statement, to):
    """Return a copy of a map after a statement, with new checksums."""
    shutil.copy(path, to)
    with closing(sqlite3.connect(to)) as db, db:
        prepare(db)
        db.execute(statement)
        update_checksums(db, "constellations")
    return to


def answers(path, frames):
    localizer = MapLocalizer.open(path)
    return [localizer.localize(frame).localization for frame, _ in frames]


def n_keyframes(path):
    with MapStore.open(path) as store:
        return len(store.keyframes())


def same(found, expected):
    for one, other in zip(found, expected, strict=True):
        for field in fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_localization_is_the_same_to_the_bit_and_describes_no_keyframe(
    saved, walk, n_described, tmp_path
):
    queries = walk[10:14]
    found = answers(saved, queries)
    assert len(n_described) == len(queries)
    assert sum(answer.is_known for answer in found) >= 2
    again = changed(saved, ANOTHER, tmp_path / "another.db")
    same(answers(again, queries), found)
    assert len(n_described) == 2 * len(queries) + n_keyframes(saved)


def test_a_map_without_constellations_is_described(saved, walk, n_described, tmp_path):
    bare = changed(saved, "DELETE FROM constellations", tmp_path / "bare.db")
    assert check_map(bare) == []
    found = answers(bare, walk[10:14])
    assert len(n_described) == 4 + n_keyframes(saved)
    for one, other in zip(found, answers(saved, walk[10:14]), strict=True):
        assert one.is_known == other.is_known
        if one.is_known:
            np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=0.01)


def test_an_atlas_takes_what_the_map_has_saved(saved, n_described, tmp_path):
    found = describe_map(saved)
    assert not n_described
    again = describe_map(changed(saved, ANOTHER, tmp_path / "another.db"))
    assert len(n_described) == len(found.ids) == n_keyframes(saved)
    for name, column in found.index.columns().items():
        assert column.tobytes() == again.index.columns()[name].tobytes()
    assert found.R_level_camera.tobytes() == again.R_level_camera.tobytes()


def test_a_session_goes_on_as_if_all_had_been_described_again(saved, walk, n_described, tmp_path):
    paths = [
        shutil.copy(saved, tmp_path / "one.db"),
        changed(saved, ANOTHER, tmp_path / "two.db"),
        changed(saved, "DELETE FROM constellations", tmp_path / "three.db"),
    ]
    counts, contents = [], []
    for path in paths:
        before = len(n_described)
        make_map(path, walk[12:16])
        counts.append(len(n_described) - before)
        with MapStore.open(path) as store:
            edges = store.select("SELECT * FROM candidates")
            new = store.select("SELECT * FROM constellations WHERE keyframe_id >= 9")
            contents.append([tuple(row) for row in (*edges, *new)])
    n = n_keyframes(saved)
    assert counts[1] == counts[2] == counts[0] + n
    assert contents[0] == contents[1] == contents[2]


def test_merging_keeps_the_constellations(saved, walk, tmp_path):
    other = make_map(tmp_path / "other.db", walk[12:15])
    merged = merge_maps([saved, other], tmp_path / "merged.db")
    with MapStore.open(tmp_path / "merged.db") as store:
        assert all(store.constellation(id_) for id_ in range(merged.n_keyframes))
        with MapStore.open(saved) as first:
            assert store.constellation(0).contours == first.constellation(0).contours
    assert check_map(tmp_path / "merged.db") == []


IMPOSSIBLE = ["zeroblob(38 * 41)", f"x'{'ff' * 38}'"]


@pytest.mark.parametrize("contours", IMPOSSIBLE, ids=["too many", "no such slice"])
def test_contours_that_cannot_be_are_not_taken(saved, walk, n_described, tmp_path, contours):
    """What a foreign map says of itself must not make a search fail, or endless."""
    forged = f"UPDATE constellations SET contours = {contours}"
    answers(changed(saved, forged, tmp_path / "forged.db"), walk[10:11])
    assert len(n_described) == 1 + n_keyframes(saved)


def test_contours_that_are_nonsense_lead_to_no_wrong_answer(saved, walk, n_described, tmp_path):
    """A small map proposes all keyframes, and alignment and the map decide."""
    contours = np.random.default_rng(0).integers(0, 256, (30, 38), np.uint8)
    contours[:, 28] %= 30  # the slice
    noise = f"UPDATE constellations SET contours = x'{contours.tobytes().hex()}', weight = 1e17"
    found = answers(changed(saved, noise, tmp_path / "noise.db"), walk[10:14])
    assert len(n_described) == 4
    for one, other in zip(found, answers(saved, walk[10:14]), strict=True):
        if one.is_known:
            np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=0.02)
