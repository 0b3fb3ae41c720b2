"""Saving keyframes beside the run: what fails is tried again, and a fork keeps its hands off."""

import os
import time
from contextlib import contextmanager

import pytest
from saved_maps import make_keyframe, make_odometry, make_record

from slam_bof.errors import MapError
from slam_bof.store import MapStore, MapWriter, Session


@pytest.fixture
def store(tmp_path):
    with MapStore.create(tmp_path / "map.db") as store:
        store.begin_session(Session(0, "7scenes", "room/seq-01", "", 0, "1.0"))
        yield store


def records(n):
    return [make_record(make_keyframe(k)) for k in range(n)]


def saved_ids(store):
    return [row["id"] for row in store.select("SELECT id FROM keyframes ORDER BY id")]


@contextmanager
def failing(store, n_times):
    """Let the next writes fail, as on a full disk."""
    write, left = store.write, [n_times]

    def fail(record, odometry):
        if left[0]:
            left[0] -= 1
            raise MapError("map.db: cannot be written: the disk is full")
        write(record, odometry)

    store.write = fail
    yield
    store.write = write


def test_a_keyframe_that_failed_once_is_saved_with_the_next(store):
    with MapWriter(store) as writer, failing(store, 1):
        for record in records(3):
            is_first = record.keyframe.id == 0
            writer.write(record, make_odometry(0) if is_first else None)
    assert saved_ids(store) == [0, 1, 2]
    assert store.odometry(0).frame_index == 0


def test_one_that_failed_again_is_reported_and_kept(store):
    first, second, third = records(3)
    with MapWriter(store) as writer, failing(store, 2):
        writer.write(first)
        with pytest.raises(MapError, match="the disk is full"):
            writer.write(second)
        writer.write(second)  # as a loop closer does with what its journal did not take
        writer.write(second)
        writer.write(third)
    assert saved_ids(store) == [0, 1, 2]


def test_the_last_one_is_tried_again_at_the_end(store):
    with MapWriter(store) as writer, failing(store, 1):
        writer.write(records(1)[0])
    assert saved_ids(store) == [0]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that forks")
@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_fork_is_refused_in_one_line_and_ends(store):
    first, second = records(2)
    with MapWriter(store) as writer:
        writer.write(first)
        pid = os.fork()
        if pid == 0:
            status = 1
            try:
                with store, writer:
                    writer.write(second)
            except MapError as error:
                status = 0 if "forked from the one that writes this map" in str(error) else 2
            finally:
                os._exit(status)
        deadline_s = time.monotonic() + 20.0
        while (ended := os.waitpid(pid, os.WNOHANG)) == (0, 0) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        if ended == (0, 0):
            os.kill(pid, 9)
        assert ended == (pid, 0)
        writer.write(second)
    assert saved_ids(store) == [0, 1]
