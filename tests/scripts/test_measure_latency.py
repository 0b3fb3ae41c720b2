"""How long a frame keeps its caller waiting, on a few frames."""

import json
import sys

import numpy as np
import pytest


@pytest.fixture(scope="module")
def latency(load_script):
    return load_script("measure_latency")


def test_both_ways_to_map_are_measured(latency, write_turn, tmp_path, monkeypatch, capsys):
    write_turn(tmp_path / "room" / "seq-01", np.linspace(0.0, 0.5, 8).tolist())
    arguments = [str(tmp_path / "room" / "seq-01"), "--rate", "100", "--json"]
    monkeypatch.setattr(sys, "argv", ["measure_latency", *arguments])
    assert latency["main"]() == 0
    direct, beside = map(json.loads, capsys.readouterr().out.splitlines())
    assert (direct["mapping"], beside["mapping"]) == ("in the caller's thread", "in the background")
    assert direct["n_keyframes"] == beside["n_keyframes"] > 1
    for row in (direct, beside):
        assert 0.0 < row["p50_ms"] <= row["p99_ms"] <= row["max_ms"]
        assert 0.0 < row["cpu_p50_ms"] <= row["cpu_max_ms"] <= 1.1 * row["max_ms"]
    assert beside["n_postponed"] == 0
