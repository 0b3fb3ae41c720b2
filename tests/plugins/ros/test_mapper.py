"""What the node does with frames, without ROS: a map is made, continued, localised in and saved."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.maps import MapLocalizer
from slam_bof.store import MapStore
from slam_bof.types import DepthFrame, Pose
from slam_bof_ros.frames import PosedFrame
from slam_bof_ros.mapper import Mapper, MapperSettings

UPRIGHT = ("gravity_odom=[0,1,0]",)


def posed(frame: DepthFrame, T_odom_camera: Pose) -> PosedFrame:
    return PosedFrame(frame, T_odom_camera, None, "camera")


@pytest.fixture
def made(tmp_path: Path, walk: list[tuple[DepthFrame, Pose]]) -> Path:
    """A map of the first look about."""
    mapper = Mapper(MapperSettings(tmp_path / "home" / "map.db", assignments=UPRIGHT))
    for frame, T in walk[:20]:
        mapper.process(posed(frame, T))
    assert mapper.is_located
    mapper.closer.drain()  # so that all keyframes are saved
    outline = mapper.outline()
    assert len(outline) == len(outline.T_map_camera) == len(outline.labels) > 4
    grid = mapper.occupancy(outline, 5)
    assert {0, 254} <= set(np.unique(grid.cells).tolist())
    copy = tmp_path / "copy.db"
    assert mapper.save(copy) == len(outline)
    assert len(MapLocalizer.open(copy)) == len(outline)
    assert mapper.finish() == 20
    assert mapper.process(posed(*walk[20])) is None
    assert mapper.save(copy) == len(outline)
    mapper.closer.close()
    return mapper.settings.map_file


def test_localization_finds_the_odometry_in_the_map_and_never_writes(
    made: Path, walk: list[tuple[DepthFrame, Pose]]
) -> None:
    before = hashlib.sha256(made.read_bytes()).hexdigest()
    mapper = Mapper(MapperSettings(made, mode="localization", assignments=UPRIGHT))
    assert not mapper.is_located
    T_odom_map = se3.exp(np.array([0.0, 0.7, 0.0, 1.0, 0.0, 2.0]))
    for frame, T in walk[20:]:
        mapper.process(posed(frame, T_odom_map @ T))
        mapper.closer.drain()
        mapper.poll()
    assert mapper.is_located
    assert mapper.T_map_odom is not None
    error = mapper.T_map_odom @ T_odom_map
    assert np.linalg.norm(error[:3, 3]) < 0.1
    assert se3.rotation_angle(error) < 0.05
    with pytest.raises(MapError, match="in localization the map is not written"):
        mapper.save(made)
    mapper.finish()
    mapper.closer.close()
    assert hashlib.sha256(made.read_bytes()).hexdigest() == before


def test_reset_begins_another_session_and_pause_leaves_frames_out(
    made: Path, walk: list[tuple[DepthFrame, Pose]]
) -> None:
    mapper = Mapper(MapperSettings(made, assignments=UPRIGHT))
    mapper.process(posed(*walk[0]))
    mapper.is_paused = True
    assert mapper.process(posed(*walk[1])) is None
    mapper.is_paused = False
    broken = posed(walk[1][0], np.full((4, 4), np.nan))
    assert mapper.process(broken) is None
    assert "found NaN" in mapper.health.errors[-1]
    mapper.reset()
    mapper.process(posed(*walk[0]))
    assert mapper.finish() == 1
    mapper.closer.close()
    with MapStore.open(made) as store:
        assert [session.is_finished for session in store.sessions()] == [True] * 3
