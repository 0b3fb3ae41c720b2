"""What is whole of a damaged map: found, named, and saved into a new one."""

from __future__ import annotations

import os
import random
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from saved_maps import make_candidate, make_keyframe, make_loop, save

from slam_bof.errors import MapError
from slam_bof.store import KEY_COLUMNS, MapStore, Session, check_map, recover_map, replay_keyframes
from slam_bof.types import LOST

VIEWS = ("loops", "loop_audit", "keyframe_labels")
Content = dict[str, list[tuple[Any, ...]]]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of two sessions, 9 keyframes and a loop between them."""
    path = tmp_path_factory.mktemp("original") / "map.db"
    with MapStore.create(path) as store:
        store.set_parameters({"model": "a1b2"})
        for id_ in range(9):
            loops = [make_loop(8, 0)] if id_ == 8 else []
            candidates = [make_candidate(8, 0)] if id_ == 8 else []
            save(store, make_keyframe(id_), candidates, loops)
        store.begin_session(Session(1, "7scenes", "room/seq-02", "seed: 3\n", 3, "1.0"))
    return path


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "map.db"
    copy.write_bytes(original.read_bytes())
    return copy


def content(path: Path) -> Content:
    with MapStore.open(path) as store:
        return {
            name: [tuple(row) for row in store.select(f"SELECT * FROM {name}")]
            for name in (*KEY_COLUMNS, *VIEWS)
        }


def change(path: Path, statement: str, *values: object) -> None:
    """Write into a map behind its back."""
    with closing(sqlite3.connect(path)) as db, db:
        db.execute(statement, values)


def flip(path: Path, at: int, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(data)


def found_by(attempt: Callable[[], object]) -> str:
    """Return what a ``MapError`` says, or nothing."""
    try:
        attempt()
    except MapError as error:
        return str(error)
    return ""


UNREADABLE_WITHOUT = (20, *range(28, 32))
"""Bytes of SQLite's header without which nothing can be read: how much of each page is reserved,
and the number of pages."""


@pytest.mark.parametrize("where", ["anywhere", "header", "statements"])
def test_a_flipped_bit_is_named_or_does_no_harm(where: str, original: Path, path: Path) -> None:
    data, expected = original.read_bytes(), content(original)
    rng = random.Random(where)
    statements = [at for at in range(len(data)) if data.startswith(b"CREATE ", at)]
    out = path.with_name("recovered.db")
    for _ in range(25):
        at = {
            "anywhere": rng.randrange(len(data)),
            "header": rng.randrange(100),
            "statements": rng.choice(statements) + rng.randrange(80),
        }[where]
        path.write_bytes(data)
        flip(path, at, rng.randrange(8))
        damage: list[object] = []
        if not found_by(lambda d=damage: d.extend(check_map(path))) and not damage:
            assert content(path) == expected, at
            continue
        out.unlink(missing_ok=True)
        if found_by(lambda: recover_map(path, out)):
            assert not out.exists()
            assert at in UNREADABLE_WITHOUT
            continue
        assert check_map(out) == [], at


def test_a_damaged_layout_is_named_and_put_back(path: Path) -> None:
    expected = content(path)
    path.write_bytes(path.read_bytes().replace(b"round(overlap, 3)", b"round(overlap, 2)"))
    assert "(view loop_audit); slam-bof map recover copies" in found_by(lambda: MapStore.open(path))
    out = path.with_name("recovered.db")
    assert recover_map(path, out)[:2] == (9, 0)
    recovered = content(out)
    assert recovered["loop_audit"] == expected["loop_audit"]
    assert recovered["keyframes"] == expected["keyframes"]


def test_what_somebody_else_has_added_is_left_alone(path: Path) -> None:
    change(path, "CREATE INDEX own ON keyframes (scene)")
    assert check_map(path) == []


def test_a_keyframe_is_lost_with_all_that_names_it(path: Path) -> None:
    change(path, "UPDATE views SET depth = zeroblob(9) WHERE keyframe_id = 3")
    assert list(map(str, check_map(path))) == [
        "depth image of keyframe 3: differs from what was written (checksum)"
    ]
    out = path.with_name("recovered.db")
    assert recover_map(path, out)[:2] == (8, 1)
    assert check_map(out) == []
    with MapStore.open(out) as store:
        assert [k.frame_index for k in store.keyframes()] == [0, 4, 8, 16, 20, 24, 28, 32]
        assert [(loop.query_id, loop.match_id) for loop in store.loops()] == [(7, 0)]
        assert len(list(replay_keyframes(store))) == 8


def test_a_damaged_constellation_costs_no_keyframe(path: Path) -> None:
    change(path, "UPDATE constellations SET weight = weight + 1 WHERE keyframe_id = 4")
    (damage,) = check_map(path)
    assert str(damage).startswith("constellation of keyframe 4: ")
    recover_map(path, path.with_name("new.db"))
    with MapStore.open(path.with_name("new.db")) as store:
        assert len(store.keyframes()) == 9
        assert [store.constellation(id_) is None for id_ in range(9)] == [k == 4 for k in range(9)]


def test_a_damaged_frame_becomes_a_lost_one_and_shifts_no_other(path: Path) -> None:
    with MapStore.open(path) as store:
        before = store.frames(0)
    change(path, "UPDATE frames SET T_odom_raw = zeroblob(96) WHERE frame_index IN (6, 7)")
    out = path.with_name("recovered.db")
    assert recover_map(path, out)[:2] == (9, 0)
    assert check_map(out) == []
    with MapStore.open(out) as store:
        after = store.frames(0)
        assert store.keyframes()[2].frame_index == 8
    np.testing.assert_allclose([f.stamp_s for f in after], [f.stamp_s for f in before])
    assert [k for k, frame in enumerate(after) if frame.segment == LOST] == [6, 7]


def test_a_damaged_session_costs_no_keyframe(path: Path) -> None:
    change(path, "UPDATE sessions SET sequence = CAST(x'726fff6d' AS TEXT), seed = 7 WHERE id = 0")
    out = path.with_name("recovered.db")
    assert recover_map(path, out)[:2] == (9, 0)
    assert check_map(out) == []
    with MapStore.open(out) as store:
        first, second = store.sessions()
    assert (first.sequence, first.seed, first.is_finished) == ("ro\ufffdm", 7, True)
    assert second.config == "seed: 3\n"


def test_a_configuration_that_is_none_any_more_is_left_out(path: Path) -> None:
    change(path, "UPDATE sessions SET config = 'seed: [' WHERE id = 0")
    out = path.with_name("recovered.db")
    assert recover_map(path, out)[:2] == (9, 0)
    with MapStore.open(out) as store:
        assert [session.config for session in store.sessions()] == ["", "seed: 3\n"]


def test_labels_are_not_kept_without_their_names(path: Path) -> None:
    change(path, "UPDATE parameters SET value = '[\"kitchen\"]' WHERE key = 'classes'")
    out = path.with_name("recovered.db")
    assert recover_map(path, out)[:2] == (9, 0)
    with MapStore.open(out) as store:
        assert [k.scene for k in store.keyframes()] == [None] * 9
    assert check_map(out) == []


def test_where_nothing_is_whole_nothing_is_made(path: Path) -> None:
    out = path.with_name("recovered.db")
    path.write_bytes(path.read_bytes()[:4096] + bytes(8192))
    assert "found a damaged database" in found_by(lambda: recover_map(path, out))
    path.write_text("SQLite is what this file is about, and it is long enough " * 40)
    assert "found no SQLite database" in found_by(lambda: recover_map(path, out))
    assert "found no file" in found_by(lambda: recover_map(path.with_name("none.db"), out))
    assert [file.name for file in path.parent.iterdir()] == ["map.db"]


def test_a_file_of_a_terabyte_that_is_no_database_is_not_copied(tmp_path: Path) -> None:
    path = tmp_path / "map.db"
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(MapError, match="found no SQLite database"):
        recover_map(path, tmp_path / "out.db")
    assert not (tmp_path / "out.db").exists()


def test_a_broken_page_is_named_or_reads_as_before(path: Path, original: Path) -> None:
    """A page of depth images whose keys are out of order finds some rows no more, or as nothing."""
    expected = content(original)
    with closing(sqlite3.connect(path)) as db:
        ((page,),) = db.execute("SELECT rootpage FROM sqlite_master WHERE name = 'views'")
        ((size,),) = db.execute("PRAGMA page_size")
    whole, start = original.read_bytes(), (page - 1) * size
    rng, n_named = random.Random(0), 0
    for _ in range(60):
        broken = bytearray(whole)
        for _ in range(30):
            broken[start + rng.randrange(size)] = rng.randrange(256)
        path.write_bytes(broken)
        damage: list[object] = []
        if found_by(lambda d=damage: d.extend(check_map(path))) or damage:
            n_named += 1
        else:
            assert content(path) == expected
    assert n_named
