"""A map.db as a file: opened, closed, locked, upgraded, damaged, cut off."""

import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from old_maps import write_old_map
from saved_maps import CLASSES, make_candidate, make_keyframe, make_loop, save, save_six

from slam_bof.errors import MapError
from slam_bof.store import MapStore, check_map, replay_keyframes
from slam_bof.store.schema import SCHEMA_VERSION


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "map.db"


@pytest.fixture
def filled(path: Path) -> Iterator[MapStore]:
    """A map of 6 keyframes with a loop."""
    with MapStore.create(path) as store:
        save_six(store, [make_candidate(5, 0)], [make_loop(5, 0)])
        yield store


def test_a_closed_map_is_one_file_that_can_be_continued(path: Path) -> None:
    with MapStore.create(path) as store:
        save(store, make_keyframe(0))
    with MapStore.open(path, read_only=False) as store:
        save(store, make_keyframe(1), [], [make_loop(1, 0)])
        assert store.classes() == CLASSES
    assert os.listdir(path.parent) == ["map.db"]
    with MapStore.open(path) as store:
        assert [k.id for k in store.keyframes()] == [0, 1]


def test_a_map_can_be_read_while_it_is_written(filled: MapStore) -> None:
    with MapStore.open(filled.path) as reader:
        assert len(reader.keyframes()) == 6
        save(filled, make_keyframe(6))
        assert len(reader.keyframes()) == 7
        with pytest.raises(MapError, match="cannot be written: the file or its folder is read-on"):
            save(reader, make_keyframe(7))


KILLED = """
import os, signal, sys
sys.path.insert(0, sys.argv[2])
from slam_bof.store import MapStore
from saved_maps import make_keyframe, make_loop, save
store = MapStore.create(sys.argv[1])
for id_ in range(20):
    save(store, make_keyframe(id_), [], [make_loop(id_, 0)])
store._db.execute("BEGIN")
store._db.execute("DELETE FROM candidates")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_run_keeps_every_keyframe_it_added(path: Path) -> None:
    here = str(Path(__file__).parents[1])
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path), here], check=False)
    assert killed.returncode == -9
    with MapStore.open(path) as store:
        assert len(store.keyframes()) == len(store.loops()) == 20
    with MapStore.open(path, read_only=False) as store:
        save(store, make_keyframe(20))
        assert len(store.keyframes()) == 21


def test_a_name_that_is_too_long_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"File name too long, expected a map\.db"):
        MapStore.open(tmp_path / (300 * "x"))


def test_a_new_map_does_not_overwrite_anything(path: Path) -> None:
    path.write_text("precious")
    with pytest.raises(MapError, match=r"map\.db: found a file, expected none"):
        MapStore.create(path)
    assert path.read_text() == "precious"
    with pytest.raises(MapError, match="cannot be opened for writing: No such"):
        MapStore.create(path.parent / "none" / "map.db")


def test_what_is_no_map_is_named(path: Path, tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"map\.db: found no file, expected a map\.db"):
        MapStore.open(path)
    with pytest.raises(MapError, match="found a folder"):
        MapStore.open(tmp_path)
    path.write_text("this is text, and long enough to be no database header " * 40)
    with pytest.raises(MapError, match="found no SQLite database"):
        MapStore.open(path)
    path.write_bytes(b"")
    with pytest.raises(MapError, match="found another program's database"):
        MapStore.open(path)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("read_only", [True, False])
def test_an_older_map_is_upgraded(path: Path, version: int, read_only: bool) -> None:
    write_old_map(path, version)
    before = path.read_bytes()
    with MapStore.open(path, read_only=read_only) as store:
        assert [k.smoothed for k in store.keyframes()] == [None, None]
        assert store.rooms() == []
        (loop,) = store.loops()
        assert (loop.query_id, loop.match_id, loop.source) == (1, 0, "view")
        assert [c.decision for c in store.candidates()] == ["accepted", "rejected"]
        ((region,), _) = store.select("SELECT region FROM keyframe_labels")
        assert region is None
        assert [session.sequence for session in store.sessions()] == ["flat/seq-01"]
        with pytest.raises(MapError, match="no depth image of keyframe 0"):
            next(replay_keyframes(store))
    assert (path.read_bytes() == before) == read_only
    with MapStore.open(path) as store:
        assert len(store.keyframes()) == 2


@pytest.mark.parametrize("read_only", [True, False])
@pytest.mark.parametrize(
    "downgrade",
    [
        "DROP TABLE constellations; DROP TABLE culled; PRAGMA user_version = 4",
        "DROP TABLE constellations; PRAGMA user_version = 5",
        "DELETE FROM constellations; PRAGMA user_version = 6",
    ],
)
def test_a_map_of_version_4_to_6_is_upgraded_and_whole(
    filled: MapStore, downgrade: str, read_only: bool
) -> None:
    filled.close()
    db = sqlite3.connect(filled.path)
    db.executescript("DROP TABLE odometry;" + downgrade)
    db.close()
    with MapStore.open(filled.path, read_only=read_only) as store:
        assert [record.constellation for record in replay_keyframes(store)] == [None] * 6
        assert store.anchors().tolist() == list(range(6))
        assert len(store.loops()) == 1
        assert store.odometry(0) is None
    if not read_only:
        assert check_map(filled.path) == []


def test_another_version_is_named(path: Path) -> None:
    MapStore.create(path).close()
    db = sqlite3.connect(path)
    db.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    db.close()
    with pytest.raises(MapError, match="found map version 8, expected one of 2, 3, 4, 5, 6, 7"):
        MapStore.open(path)


def test_a_damaged_map_is_named(filled: MapStore, tmp_path: Path) -> None:
    filled.close()
    damaged = tmp_path / "damaged.db"
    content = bytearray(filled.path.read_bytes())
    content[4096:] = b"\xa5" * (len(content) - 4096)
    damaged.write_bytes(content)
    with pytest.raises(MapError, match="found a damaged"), MapStore.open(damaged) as store:
        store.keyframes()


def test_a_second_writer_is_told(filled: MapStore) -> None:
    link = filled.path.with_name("link.db")
    link.symlink_to(filled.path.name)
    for attempt in (
        lambda: MapStore.open(filled.path, read_only=False),
        lambda: MapStore.open(link, read_only=False),
        lambda: again(filled),
    ):
        with pytest.raises(MapError, match="locked by another program") as caught:
            attempt()
        assert "\n" not in str(caught.value)
    filled.close()
    MapStore.open(link, read_only=False).close()
    assert sorted(os.listdir(filled.path.parent)) == ["link.db", "map.db"]


def again(store: MapStore) -> None:
    MapStore.create(store.path)


def test_a_full_disk_is_named_and_loses_nothing(filled: MapStore) -> None:
    ((pages,),) = filled.select("PRAGMA page_count")
    filled.select(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(MapError, match=r"map\.db: cannot be written: the disk is full"):
        save(filled, make_keyframe(6))
    assert len(filled.keyframes()) == 6


@pytest.mark.parametrize("then", ["nothing", "another"])
def test_a_map_that_is_removed_while_it_is_written_is_missed(filled: MapStore, then: str) -> None:
    filled.path.unlink()
    if then == "another":
        filled.path.write_bytes(b"precious")
    with pytest.raises(MapError, match=r"map\.db: found it removed or replaced while it was"):
        save(filled, make_keyframe(6))
    filled.close()
    assert filled.path.exists() == (then == "another")


def test_a_map_that_cannot_be_made_leaves_nothing(path: Path) -> None:
    (path.parent / ".map.db.new-journal").mkdir()
    with pytest.raises(MapError, match="cannot be opened"):
        MapStore.create(path)
    assert os.listdir(path.parent) == [".map.db.new-journal"]


def test_a_finished_map_can_be_read_where_nothing_can_be_written(filled: MapStore) -> None:
    filled.close()
    folder = filled.path.parent / "medium"
    folder.mkdir()
    shutil.copy(filled.path, folder / "map.db")
    (folder / "map.db").chmod(0o400)
    folder.chmod(0o500)
    try:
        with MapStore.open(folder / "map.db") as store:
            assert len(store.keyframes()) == 6
        assert os.listdir(folder) == ["map.db"]
    finally:
        folder.chmod(0o700)
