"""A run near its limit of memory says so, and goes on without looking for old places."""

import logging

import numpy as np

from slam_bof.core import machine_memory_mb, peak_rss_mb, rss_mb
from slam_bof.maps import MapSession
from slam_bof.slam import LoopCloser, config as configs
from slam_bof.store import MapStore, check_map
from slam_bof.types import DepthFrame


def process(closer, frames):
    """Process frames, without what was computed of them before; return all candidates."""
    return [
        candidate
        for frame, T in frames
        for candidate in closer.process(
            DepthFrame(frame.stamp_s, frame.depth, frame.intrinsics), T
        ).candidates
    ]


def test_the_memory_of_this_process_and_its_machine():
    found_mb = rss_mb()
    assert 20.0 < found_mb < peak_rss_mb() + 1.0
    block = np.ones(25_000_000)
    assert rss_mb() > found_mb + 100.0
    assert rss_mb() < machine_memory_mb() < 1e9
    assert block.size


def test_beyond_the_limit_keyframes_are_not_searched_for(walk, caplog):
    config = configs.override(configs.preset("indoor"), ["map.max_memory_mb=1"])
    closer = LoopCloser.from_config(config)
    with caplog.at_level(logging.WARNING):
        assert process(closer, walk) == []
    (record,) = [r for r in caplog.records if "map.max_memory_mb" in r.message]
    assert "expected at most 1 MB" in record.message
    assert len(closer.map) > 10
    assert closer.map.loops == []
    np.testing.assert_allclose(closer.finish().poses, closer.history.odometry().poses, atol=0.05)


def test_what_was_found_before_the_limit_stays(walk, tmp_path):
    with MapSession.open(tmp_path / "map.db", config=configs.preset("indoor")) as session:
        closer = session.closer
        process(closer, walk[:30:2])
        loops = len(closer.map.loops)
        assert loops > 2
        closer.map._memory_limit.max_mb = 1.0
        assert process(closer, walk[30::2]) == []
        assert len(closer.map.loops) == loops
        n_keyframes = len(closer.map)
    assert check_map(tmp_path / "map.db") == []
    with MapStore.open(tmp_path / "map.db") as store:
        assert len(store.keyframes()) == n_keyframes
        assert np.isfinite(store.map_poses()).all()
