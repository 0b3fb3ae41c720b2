"""The ROS node is measured on a few frames over DDS."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT

pytest.importorskip("rclpy", reason="needs ROS 2: pip install -e '.[ros]', or a ROS installation")


def test_topics_latency_and_processes_are_measured(write_turn, tmp_path):
    write_turn(tmp_path / "room" / "seq-01", np.linspace(0.0, 0.5, 10).tolist())
    paths = [ROOT, ROOT / "plugins", ROOT / "plugins" / "slam_bof_ros"]
    known = filter(None, [os.environ.get("PYTHONPATH")])
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "measure_node"), str(tmp_path / "room" / "seq-01"),
         "--rate", "4", "--json"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*map(str, paths), *known])},
        capture_output=True, text=True, timeout=480, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    *topics, latency, node, map_ = map(json.loads, done.stdout.splitlines())
    n = {row["topic"]: row["n"] for row in topics}
    assert 5 <= n["pose"] <= 10
    assert n["map_to_odom"] > n["pose"], "at 20 Hz beside 4 Hz"
    assert 0.0 < latency["p50"] <= latency["p99"] <= latency["max"]
    assert latency["n"] == n["pose"]
    assert (node["what"], map_["what"]) == ("node", "its map")
    for row in (node, map_):
        assert row["cpu"] > 0.0
        assert 50 < row["mb"] < 2000
