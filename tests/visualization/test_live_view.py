"""What the viewer is given, read back from the file that it is recorded in."""

import sys
from collections import Counter

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm
from rrd import read_rrd

from slam_bof.errors import PluginError
from slam_bof.geometry import se3
from slam_bof.ports import NullObserver
from slam_bof.slam import LoopCloser
from slam_bof.types import DepthFrame
from slam_bof.visualization import LiveView, rerun_recording


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
    pytest.importorskip("rerun", reason="needs rerun: pip install slam-bof[view]")
    turn, closer, other = Turn(), LoopCloser.from_preset(), Counting()
    file = tmp_path / "turn.rrd"
    with LiveView(other, turn, str(file)) as view:
        view.on_start(15)
        for k in range(15):
            view.on_step(k, closer.process(turn.frame(k), turn.pose(k)))
        view.on_warning("it is dark")
    assert other.calls == {"step": 15, "it is dark": 1}
    rows = read_rrd(file)
    at = [row["Transform3D:translation"] for row in rows["/map/camera"]]
    assert len(at) == 15
    assert np.abs(at).max() < 0.02, "it turns on the spot"
    assert len(rows["/health/open_directions"]) == len(rows["/time/frame_ms"]) == 15
    assert rows["/uncertainty/position_m"]
    assert len(rows["/warnings"]) == 1
    ids = [keyframe.id for keyframe in closer.map.keyframes]
    assert len(ids) > 2
    for k in ids:
        assert len(rows[f"/map/points/{k}"]) == len(rows[f"/map/path/{k}"]) == 1
        (keyframe,) = rows[f"/map/keyframes/{k}"]
        assert keyframe["Points3D:labels"][0].startswith(f"keyframe {k}, ")
        assert np.abs(keyframe["Points3D:positions"]).max() < 0.02


def test_without_rerun_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(PluginError, match=r"pip install 'slam-bof\[view\]'"):
        LiveView(NullObserver(), Turn(), "live")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have a display")
def test_without_a_display_it_says_so(monkeypatch):
    pytest.importorskip("rerun", reason="needs rerun: pip install slam-bof[view]")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(rerun_recording, "VIEWER_PORT", 1)
    with pytest.raises(PluginError, match="found no display for rerun"):
        LiveView(NullObserver(), Turn(), "live")


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    pytest.importorskip("rerun", reason="needs rerun: pip install slam-bof[view]")
    with pytest.raises(OSError, match=r"gone/turn\.rrd"):
        LiveView(NullObserver(), Turn(), str(tmp_path / "gone" / "turn.rrd"))
