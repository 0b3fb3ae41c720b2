"""Maps that slam_bof has not written so: damaged, contradictory or hostile."""

from __future__ import annotations

import io
import json
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from old_maps import write_old_map
from saved_maps import (
    CAMERA,
    make_candidate,
    make_keyframe,
    make_loop,
    make_odometry,
    make_record,
    save,
)

from slam_bof.errors import MapError
from slam_bof.maps import merge_maps
from slam_bof.scenes import MapRoom
from slam_bof.store import (
    KEY_COLUMNS,
    MapStore,
    SessionResult,
    check_map,
    prune_map,
    query_keyframes,
    query_loops,
    query_rooms,
    recover_map,
    replay_keyframes,
)
from slam_bof.store.row_checks import CHECKS
from slam_bof.store.sqlite import possible_rowids, prepare, update_checksums

SOURCE = json.dumps({"path": "home/seq-01", "frames": "0:6"})


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished map of 6 keyframes with a loop and a room."""
    path = tmp_path_factory.mktemp("original") / "map.db"
    room = MapRoom(0, "kitchen", 0.6, (0, 2), (0.0, 1.0, 2.0), (-1.0, 0.0, 1.0), (1.0, 2.0, 3.0))
    with MapStore.create(path) as store:
        store.set_parameters({"model": "a1b2", "units_per_m": 1000.0, "source": SOURCE})
        for id_ in range(5):
            save(store, make_keyframe(id_))
        last = make_record(make_keyframe(5), [make_candidate(5, 0)], [make_loop(5, 0)])
        store.write(last, make_odometry(20))
        keyframes = store.keyframes()
        poses = np.array([keyframe.T_odom_camera for keyframe in keyframes])
        store.finish(0, SessionResult([], poses, [k.scene for k in keyframes], [room]))
    return path


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "map.db"
    copy.write_bytes(original.read_bytes())
    return copy


@contextmanager
def changing(path: Path) -> Iterator[sqlite3.Connection]:
    """Change a map behind its back."""
    with closing(sqlite3.connect(path)) as db, db:
        prepare(db)
        yield db


def sign(db: sqlite3.Connection) -> None:
    """Give every row the checksum of what it now has."""
    for table in KEY_COLUMNS:
        update_checksums(db, table)


def read_everything(path: Path) -> None:
    with MapStore.open(path) as store:
        query_keyframes(store)
        query_loops(store, considered=True)
        query_rooms(store)
        for session in store.sessions():
            store.frames(session.id)
            store.odometry(session.id)
        assert store.intrinsics() is not None
        for _ in replay_keyframes(store):
            pass


def blob(numbers: object, dtype: str = "<f8") -> bytes:
    return np.asarray(numbers, dtype).tobytes()


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


CAMERA_JSON = json.dumps(asdict(CAMERA))
HUGE_CAMERA = json.dumps(asdict(CAMERA) | {"width": 200_000, "height": 200_000})
IMPLAUSIBLE: list[tuple[str, object]] = [
    ("keyframes SET map_tx = ?", float("inf")),
    ("keyframes SET odom_tx = ?", 1e38),
    ("keyframes SET odom_qw = ?", 7.0),
    ("keyframes SET stamp_s = ?", "noon"),
    ("keyframes SET stamp_s = ?", b"\0\0"),
    ("keyframes SET segment = ?", -3),
    ("keyframes SET session = ?", 4),
    ("keyframes SET words = ?", blob([3, 2, 1], "<i4")),
    ("keyframes SET words = ?", b"odd"),
    ("keyframes SET weights = ?", blob(np.full(200, np.nan), "<f4")),
    ("keyframes SET probabilities = ?", blob([np.nan, 0.5])),
    ("keyframes SET probabilities = ?", blob([0.5, 0.5, 0.0])),
    ("keyframes SET frame_index = 100 - frame_index WHERE ?", 1),
    ("keyframes SET id = 7 WHERE id = 5 AND ?", 1),
    ("views SET per_m = ?", 0),
    ("views SET depth = ?", b"no picture"),
    ("views SET depth = ?", b""),
    ("constellations SET gravity = ?", blob([0.0, np.nan, 0.0])),
    ("constellations SET gravity = ?", blob([0.0, 1.0])),
    ("constellations SET contours = ?", b"no contour"),
    ("constellations SET weight = ?", -6.0),
    ("constellations SET weight = ?", 1e38),
    ("constellations SET describer = ?", b"0a1b"),
    ("odometry SET name = ? WHERE name = 'skipped'", "spare"),
    ("odometry SET frame_index = ?", -1),
    ("odometry SET value = ?", b"no array"),
    ("odometry SET value = ? WHERE name = 'skipped'", npy(np.array([1.0, 3.0]))),
    ("odometry SET value = ? WHERE name = 'state/n'", npy(np.array(["a"]))),
    ("frames SET T_odom_raw = ?", blob(np.full((3, 4), np.nan))),
    ("frames SET T_odom_camera = ?", blob(np.zeros((3, 4)))),
    ("frames SET T_odom_camera = ?", blob([1.0])),
    ("frames SET segment = ?", "two"),
    ("candidates SET source = ?", "hearsay"),
    ("candidates SET kind = ?", 3),
    ("candidates SET decision = ?", b"accepted"),
    ("candidates SET information = ?", blob(np.full((6, 6), np.nan))),
    ("candidates SET information = ?", blob(-np.eye(6))),
    ("candidates SET information = ?", b""),
    ("candidates SET match_id = ?", 77),
    ("candidates SET tx = ?", None),
    ("regions SET probability = ?", 7.0),
    ("regions SET low_x = ?", float("-inf")),
    ("sessions SET state = ?", "[" * 100_000),
    ("sessions SET seed = ?", -1),
    ("sessions SET sequence = ?", b"\xff"),
    ("parameters SET value = ? WHERE key = 'camera'", HUGE_CAMERA),
    ("parameters SET value = ? WHERE key = 'camera'", CAMERA_JSON.replace("50.0", "NaN")),
    ("parameters SET value = ? WHERE key = 'camera'", CAMERA_JSON.replace("width", "uidth")),
    ("parameters SET value = ? WHERE key = 'camera'", "9" * 5000),
    ("parameters SET value = ? WHERE key = 'classes'", "[1, 2]"),
    ("parameters SET value = ? WHERE key = 'classes'", '["kitchen"]'),
    ("parameters SET value = ? WHERE key = 'units_per_m'", '"many"'),
    ("parameters SET value = ? WHERE key = 'source'", "home"),
    ("parameters SET value = ? WHERE key = 'source'", "[]"),
    ("parameters SET value = ? WHERE key = 'source'", "null"),
    ("parameters SET value = ? WHERE key = 'source'", '{"path": 5}'),
    ("parameters SET value = ? WHERE key = 'source'", '{"path": "a\\u0000b"}'),
    ("parameters SET value = ? WHERE key = 'source'", '{"path": "home", "frames": 7}'),
    ("parameters SET value = ? WHERE key = 'source'", json.dumps({"path": "x" * 5000})),
]


@pytest.mark.parametrize(("change", "value"), IMPLAUSIBLE)
def test_what_no_map_can_have_is_refused_under_a_right_checksum(
    path: Path, change: str, value: object
) -> None:
    with changing(path) as db:
        db.execute(f"UPDATE {change}", (value,))
        sign(db)
    with pytest.raises(MapError, match=r"map\.db: found") as caught:
        read_everything(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
    assert check_map(path)
    for copying in (lambda: prune_map(path, lambda store: [1]), lambda: merge_maps([path], path)):
        with pytest.raises(MapError):
            copying()


def test_a_pair_without_correspondences_is_no_damage(path: Path) -> None:
    with changing(path) as db:
        db.execute("UPDATE candidates SET rmse_m = 9e999")
        sign(db)
    read_everything(path)
    with MapStore.open(path) as store:
        found = query_loops(store, considered=True)
    assert found
    assert all(np.isinf(candidate.rmse_m) for candidate in found)


def test_every_table_has_checks() -> None:
    assert set(CHECKS) == set(KEY_COLUMNS)


FLIPS = [
    (b'"fx": 50.0', b'"fx": 58.0'),
    (b'"width": 6', b'"uidth": 6'),
]


@pytest.mark.parametrize(("old", "new"), FLIPS)
def test_a_flipped_bit_in_the_camera_is_named_by_every_reader(
    path: Path, old: bytes, new: bytes
) -> None:
    data = path.read_bytes()
    assert data.count(old) == 1
    path.write_bytes(data.replace(old, new))
    with pytest.raises(MapError, match="damaged row of parameters, camera"):
        read_everything(path)
    assert [str(damage) for damage in check_map(path)] == [
        "parameter camera: differs from what was written (checksum)"
    ]
    out = path.with_name("recovered.db")
    assert recover_map(path, out) == (6, 0, True)
    assert [str(damage) for damage in check_map(out)] == ["parameter camera: is missing"]


@pytest.mark.parametrize(
    "copy",
    [
        lambda path: prune_map(path, lambda store: [1]),
        lambda path: merge_maps([path, path.with_name("other.db")], path.with_name("out.db")),
        lambda path: merge_maps([path.with_name("other.db"), path], path.with_name("out.db")),
    ],
)
def test_damage_is_not_signed_by_copying_it(
    original: Path, path: Path, copy: Callable[[Path], object]
) -> None:
    path.with_name("other.db").write_bytes(original.read_bytes())
    with changing(path) as db:
        db.execute("UPDATE keyframes SET map_tx = map_tx + 0.84 WHERE id = 4")
    damaged = path.read_bytes()
    with pytest.raises(MapError, match=r"1 place, the first is keyframe 4: differs .* recover"):
        copy(path)
    assert path.read_bytes() == damaged
    assert not path.with_name("out.db").exists()


@pytest.mark.parametrize("version", [2, 3])
def test_a_damaged_old_map_is_not_upgraded(path: Path, version: int) -> None:
    path.unlink()
    write_old_map(path, version)
    with changing(path) as db:
        db.execute("UPDATE keyframes SET odom_tx = 9e999 WHERE id = 1")
    before = path.read_bytes()
    with pytest.raises(MapError, match="found keyframes, row 1, which has no plausible odom_tx"):
        MapStore.open(path, read_only=False)
    assert path.read_bytes() == before
    with (
        MapStore.open(path) as store,
        pytest.raises(MapError, match="damaged row of keyframes, 1, which has no plausible odom"),
    ):
        store.keyframes()


ENDLESS = "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n"
ADDITIONS = {
    "trigger": f"CREATE TRIGGER t AFTER UPDATE ON keyframes BEGIN {ENDLESS}; END",
    "view": f"CREATE VIEW v AS {ENDLESS}",
    "table": "CREATE TABLE t (id)",
}


@pytest.mark.parametrize("kind", ADDITIONS)
@pytest.mark.parametrize("version", [2, 4])
def test_what_would_run_in_a_foreign_map_is_refused(path: Path, kind: str, version: int) -> None:
    if version == 2:
        path.unlink()
        write_old_map(path, version)
    with changing(path) as db:
        db.execute(ADDITIONS[kind])
    for read_only in (True, False):
        with pytest.raises(MapError, match=f"found {kind} '[tv]' in the database, which slam_bof"):
            MapStore.open(path, read_only=read_only)


def test_a_table_that_is_a_view_is_refused(path: Path) -> None:
    path.unlink()
    write_old_map(path, 3)
    with changing(path) as db:
        db.execute("DROP TABLE regions")
        db.execute(f"CREATE VIEW regions AS {ENDLESS}")
    with pytest.raises(MapError, match="found view 'regions' in the database"):
        MapStore.open(path)


def test_a_value_of_gigabytes_is_not_read(path: Path) -> None:
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("UPDATE views SET depth = zeroblob(50000000) WHERE keyframe_id = 2")
    with pytest.raises(MapError, match="found a value of more than 16777216 bytes"):
        read_everything(path)
    assert any("16777216 bytes" in str(d) or "too big" in str(d) for d in check_map(path))


@pytest.mark.parametrize(
    "change",
    [
        "sessions SET id = 1 << 60",
        "frames SET frame_index = 1 << 50 WHERE frame_index = 20",
        "candidates SET id = 1 << 60",
    ],
)
def test_a_number_far_away_does_not_make_recovery_try_all_before(path: Path, change: str) -> None:
    with changing(path) as db:
        db.execute(f"UPDATE {change}")
        sign(db)
        assert len(possible_rowids(db, change.split()[0])) < path.stat().st_size
    out = path.with_name("recovered.db")
    with suppress(MapError):
        recover_map(path, out)
        assert check_map(out) == []


def test_a_picture_larger_than_its_camera_is_not_decoded(path: Path) -> None:
    """Its header says 60,000 x 60,000 pixels: 7 GB."""
    with changing(path) as db:
        ((png,),) = db.execute("SELECT depth FROM views WHERE keyframe_id = 3").fetchall()
        png = png[:16] + (60_000).to_bytes(4, "big") * 2 + png[24:]
        db.execute("UPDATE views SET depth = ? WHERE keyframe_id = 3", (png,))
        sign(db)
    with pytest.raises(MapError, match="damaged depth image of keyframe 3"):
        read_everything(path)


def test_a_map_read_within_a_snapshot_is_of_one_moment(path: Path) -> None:
    with MapStore.open(path, read_only=False) as writer, MapStore.open(path) as reader:
        with reader.snapshot():
            assert len(reader.keyframes()) == 6
            save(writer, make_keyframe(6))
            assert len(reader.keyframes()) == 6
        assert len(reader.keyframes()) == 7


def test_a_connection_trusts_no_file(tmp_path: Path) -> None:
    with MapStore.create(tmp_path / "map.db"):
        pass
    with MapStore.open(tmp_path / "map.db") as store:
        assert store.connection.execute("PRAGMA trusted_schema").fetchone()[0] == 0
        if sys.version_info >= (3, 12):
            assert store.connection.getconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE)
