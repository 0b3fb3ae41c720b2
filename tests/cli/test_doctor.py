"""Commands about the installation: version, plugins, config and doctor."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import refusal, slam_bof


def test_version() -> None:
    assert slam_bof("version").stdout == f"slam-bof {metadata.version('slam-bof')}\n"
    assert json.loads(slam_bof("version", "--json").stdout) == {
        "version": metadata.version("slam-bof")
    }


def test_plugins_lists_all_and_checks_on_demand() -> None:
    listed = json.loads(slam_bof("plugins", "--json").stdout)
    assert {"kiss-icp", "7scenes", "gtsam", "open3d"} <= {item["name"] for item in listed}
    assert {item["state"] for item in listed} == {"installed"}
    result = slam_bof("plugins", "--check", "--json")
    assert result.exit_code == 0
    assert {item["state"] for item in json.loads(result.stdout)} == {"ok"}
    assert "kiss-icp" in slam_bof("plugins").stdout


def test_a_plugin_that_does_not_load_is_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[slam_bof.odometry]\nnone = no_such_library:X\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    result = slam_bof("plugins", "--check", "--json")
    assert result.exit_code == 1
    (state,) = [item["state"] for item in json.loads(result.stdout) if item["name"] == "none"]
    assert "cannot be loaded: No module named 'no_such_library'" in state


def test_config_prints_presets_and_checks_files(tmp_path: Path) -> None:
    text = slam_bof("config", "paper").stdout
    assert yaml.safe_load(text)["keyframes"]["policy"] == "every"
    assert json.loads(slam_bof("config", "paper", "--json").stdout) == yaml.safe_load(text)
    file = tmp_path / "my.yaml"
    file.write_text(text)
    assert slam_bof("config", file).stdout == text
    assert "top_k: 9" in slam_bof("config", file, "--set", "loops.top_k=9").stdout
    file.write_text("loops: {topk: 3}")
    assert "my.yaml: unknown key 'loops.topk'; did you mean 'top_k'?" in refusal("config", file)
    file.write_text("backend: {name: gtsam, options: {cauchi: 3}}")
    assert "'gtsam': unknown key 'cauchi'; did you mean 'cauchy'?" in refusal("config", file)


def test_doctor_looks_over_the_installation() -> None:
    result = slam_bof("doctor", "--json")
    found = {item["what"]: item for item in json.loads(result.stdout)}
    assert found["Python"]["ok"]
    assert found["numpy"]["found"] == np.__version__
    assert found["Open3D import"]["ok"]
    assert found["libusb"]["ok"]
    assert found["Compiled code"]["found"].endswith("__pycache__")
    assert "Disk space here" in found
    assert all(item["remedy"] for item in found.values() if not item["ok"])
    assert result.exit_code == (0 if all(item["ok"] for item in found.values()) else 1)
    assert "Open3D import" in slam_bof("doctor").stdout
