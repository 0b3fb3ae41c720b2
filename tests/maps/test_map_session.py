"""Mapping on in a map from Python: begun, interrupted, finished, added to."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.maps import MapLocalizer, MapSession
from slam_bof.slam import preset
from slam_bof.slam.config import override
from slam_bof.store import MapStore
from slam_bof.types import DepthFrame

QUICK = override(preset("indoor"), ["keyframes.max_gap=2"])
N = 9


def walk(n=N):
    """A turn in a box room: frames and odometry."""
    for k in range(n):
        T = se3.exp(np.array([0.0, 0.03 * k, 0.0, 0.0, 0.0, 0.0]))
        yield DepthFrame(k / 30, box_room_depth_mm(CAMERA, T), CAMERA), T


def process(session, n=N):
    for frame, T_odom_camera in walk(n):
        session.closer.process(frame, T_odom_camera)


def sessions(path):
    with MapStore.open(path) as store:
        assert np.isfinite(store.map_poses()).all()
        return [(s.sequence, s.is_finished, len(store.frames(s.id))) for s in store.sessions()]


@pytest.mark.parametrize("background", [False, True])
def test_a_session_makes_a_map_and_another_one_extends_it(tmp_path, background):
    path, options = tmp_path / "home.db", {"config": QUICK, "background": background}
    with MapSession.open(path, camera=CAMERA, sequence="monday", **options) as session:
        process(session)
    assert session.trajectory is not None
    assert len(session.trajectory) == N
    with MapSession.open(path, sequence="tuesday") as session:
        assert session.closer.map.session == 1
        process(session, 4)
    assert sessions(path) == [("monday", True, N), ("tuesday", True, 4)]
    with MapStore.open(path) as store:
        assert store.sessions()[1].config == store.sessions()[0].config
        assert "max_gap: 2" in store.sessions()[1].config
    assert len(MapLocalizer.open(path)) > 0
    (tmp_path / "run").mkdir()
    path.rename(tmp_path / "run" / "map.db")
    assert len(MapLocalizer.open(tmp_path / "run")) > 0


def crash(path):
    with MapSession.open(path, config=QUICK, sequence="monday") as session:
        process(session)
        raise ZeroDivisionError


def test_an_exception_finishes_the_session_and_goes_on(tmp_path):
    path = tmp_path / "home.db"
    with pytest.raises(ZeroDivisionError):
        crash(path)
    assert sessions(path) == [("monday", True, N)]


KILLED = """
import os, sys
sys.path[:0] = {path!r}
from test_map_session import QUICK, MapSession, process
session = MapSession.open({file!r}, config=QUICK, sequence="monday")
process(session)
session._writer.wait()
os._exit(9)
"""


@pytest.fixture
def killed(tmp_path):
    """The map of a program that was killed, whose data are gone."""
    path = tmp_path / "home.db"
    program = KILLED.format(path=sys.path, file=str(path))
    done = subprocess.run([sys.executable, "-c", program], check=False, cwd=os.getcwd())
    assert done.returncode == 9
    with MapStore.open(path) as store:
        assert not store.sessions()[0].is_finished
    return path


def test_what_a_killed_program_left_can_be_finished(killed):
    run = CliRunner().invoke
    assert "slam-bof map finish" in run(app, ["localize", str(killed), "image.png"]).output
    result = run(app, ["map", "finish", str(killed), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert found["session"] == 0
    assert found["n_keyframes"] >= 3
    ((_, is_finished, n_frames),) = sessions(killed)
    assert is_finished
    assert n_frames >= N - 2  # those after the last keyframe are lost
    again = run(app, ["map", "finish", str(killed)])
    assert "all sessions are finished" in again.output
    assert len(MapLocalizer.open(killed)) == found["n_keyframes"]


def test_the_next_session_finishes_it_too(killed):
    with MapSession.open(killed, sequence="tuesday") as session:
        process(session, 3)
    assert [is_finished for _, is_finished, _ in sessions(killed)] == [True, True]


def test_another_camera_is_refused_before_anything_is_written(tmp_path):
    path = tmp_path / "home.db"
    with MapSession.open(path, config=QUICK) as session:
        process(session)
    zoomed = replace(CAMERA, fx=1.1 * CAMERA.fx)
    with pytest.raises(MapError, match="all sessions of a map use one camera"):
        MapSession.open(path, camera=zoomed)
    assert len(sessions(path)) == 1
    with MapSession.open(path, camera=CAMERA):  # the file is not locked, and no frame is no harm
        pass
    assert sessions(path)[1:] == [("", True, 0)]
