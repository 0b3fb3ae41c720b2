"""What the viewer is given, read back from the file that it is recorded in."""

import sys
from collections import Counter

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.errors import PluginError
from slam_bof.geometry import se3
from slam_bof.ports import NullObserver
from slam_bof.slam import LoopCloser
from slam_bof.types import DepthFrame
from slam_bof.visualization import LiveView, live_view


class Turn:
    """A camera that turns in a box room."""

    sequence = "box/turn"

    def frame(self, index):
        return DepthFrame(index / 30, box_room_depth_mm(CAMERA, self.pose(index)), CAMERA)

    def pose(self, index):
        return se3.exp(np.array([0.0, 0.04 * index, 0.0, 0.0, 0.0, 0.0]))


class Counting(NullObserver):
    def __init__(self):
        self.calls = Counter()

    def on_step(self, frame_index, step):
        self.calls["step"] += 1

    def on_warning(self, message):
        self.calls[message] += 1


def test_a_run_is_recorded_and_read_back(tmp_path):
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun: pip install slam-bof[view]")
    turn, closer, other = Turn(), LoopCloser.from_preset(), Counting()
    file = tmp_path / "turn.rrd"
    with LiveView(other, turn, str(file)) as view:
        view.on_start(15)
        for k in range(15):
            view.on_step(k, closer.process(turn.frame(k), turn.pose(k)))
        view.on_warning("it is dark")
    assert other.calls == {"step": 15, "it is dark": 1}
    rows = Counter()
    positions = []
    for part in chunk.RrdReader(str(file)).stream().to_chunks():
        rows[part.entity_path] += part.num_rows
        if part.entity_path == "/map/camera":
            batch = part.to_record_batch()
            names = [name for name in batch.schema.names if "translation" in name]
            positions += [np.ravel(p) for name in names for p in batch.column(name).to_pylist()]
    assert rows["/map/camera"] >= 15
    assert rows["/health/open_directions"] == rows["/time/frame_ms"] == 15
    assert rows["/warnings"] == 1
    ids = [keyframe.id for keyframe in closer.map.keyframes]
    assert len(ids) > 2
    for k in ids:
        assert rows[f"/map/points/{k}"] == rows[f"/map/path/{k}"] == 1
    assert np.abs(positions).max() < 0.02, "it turns on the spot"


def test_without_rerun_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(PluginError, match=r"pip install 'slam-bof\[view\]'"):
        live_view.LiveView(NullObserver(), Turn(), "live")
