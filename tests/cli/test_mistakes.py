"""Mistakes of the user: one line and an exit code, and nothing that was written is lost."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import N_FRAMES, in_process, refusal, slam_bof, write_box_sequence, write_tiny_model


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_box_sequence(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_model(tmp_path_factory.mktemp("model") / "tiny.bof")


def test_usage_errors_exit_with_2() -> None:
    for arguments in (["bogus"], ["run"], ["run", "x", "--max-frames", 0], ["query", "x", "--z"]):
        assert slam_bof(*arguments).exit_code == 2, arguments


@pytest.fixture
def attempt(room: Path, model_file: Path, tmp_path: Path) -> Iterator[list[object]]:
    """Arguments of a run that would work; what a test adds spoils it, and nothing is written."""
    out = tmp_path / "runs"
    yield ["run", room, "--out", out, "--model", model_file]
    assert not out.exists() or list(out.iterdir()) == []


def test_sequences_that_are_none(tmp_path: Path, room: Path) -> None:
    assert "none: found nothing, expected the folder of a sequence" in refusal(
        "run", tmp_path / "none"
    )
    assert "found a file, expected the folder" in refusal("run", room / "scenes.csv")
    assert "found no known layout, expected one of: 7scenes" in refusal("run", tmp_path)
    assert "expected 7-Scenes layout" in refusal("run", tmp_path, "--dataset", "7scenes")
    assert "no datasets plug-in 'kitti'; installed: " in refusal("run", room, "--dataset", "kitti")


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--config", "indor"], "no preset 'indor'; did you mean 'indoor'?"),
        (["--config", "none.yaml"], "none.yaml: no such file"),
        (["--set", "loops.topk=3"], "unknown key 'loops.topk'; did you mean 'top_k'?"),
        (["--set", "odometry=magic"], "no odometry plug-in 'magic'; installed: genz-icp, kiss-icp"),
        (["--set", "verifier=magic"], "no verifiers plug-in 'magic'"),
        (["--set", "odometry.options.voxel_m=1"], "unknown key 'voxel_m'"),
        (["--set", "backend.options.cauchy=-1"], "key 'cauchy': found -1"),
        (["--model", "none.bof"], "none.bof: no such model file"),
    ],
)
def test_parameters_that_are_wrong(attempt: list[object], extra: list[str], message: str) -> None:
    assert message in refusal(*attempt, *extra)


def test_a_model_of_another_kind(attempt: list[object], tmp_path: Path) -> None:
    other = tmp_path / "other.bof"
    other.write_bytes(b"not a model")
    assert "other.bof: not a model file" in refusal(*attempt, "--model", other)


def test_a_place_that_cannot_be_written(attempt: list[object], room: Path) -> None:
    file = room / "scenes.csv"
    assert f"{file}" in refusal(*attempt, "--out", file)
    assert f"{file}" in refusal(*attempt, "--out", file / "runs")


def test_poses_that_are_none(room: Path, tmp_path: Path) -> None:
    sequence = tmp_path / "seq-01"
    sequence.mkdir()
    for file in room.iterdir():
        (sequence / file.name).write_bytes(file.read_bytes())
    (sequence / "frame-000003.pose.txt").write_text("nan " * 16)
    options = ("-o", tmp_path / "runs", "--max-frames", 3, "--quiet", "--json")
    result = slam_bof("run", sequence, *options)
    assert result.exit_code == 0
    assert json.loads(result.stdout)["n_frames"] == 3


@pytest.mark.skipif(os.name != "posix", reason="needs resource limits")
def test_a_full_disk_is_one_line_and_keeps_what_was_written(
    room: Path, model_file: Path, tmp_path: Path
) -> None:
    """A limit on the size of files stands for the full disk: writes fail half-way for real."""

    def limit() -> None:
        import resource

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    process = in_process(
        "run", room, "-o", tmp_path, "--model", model_file, "--quiet", preexec_fn=limit
    )
    out, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1, err
    assert str(tmp_path) in err
    (folder,) = (path for path in tmp_path.iterdir() if not path.is_symlink())
    assert (folder / "config.yaml").stat().st_size > 0


@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_interrupting_leaves_a_readable_map(room: Path, model_file: Path, tmp_path: Path) -> None:
    sequence = tmp_path / "long" / "seq-01"
    sequence.mkdir(parents=True)
    for number in range(3000):
        (sequence / f"frame-{number:06d}.depth.png").symlink_to(
            room / f"frame-{number % N_FRAMES:06d}.depth.png"
        )
    out = tmp_path / "runs"
    process = in_process("run", sequence, "-o", out, "--model", model_file, "--quiet")
    deadline = time.monotonic() + 180
    map_file = out / "latest" / "map.db"
    while process.poll() is None and time.monotonic() < deadline:
        # The first keyframe is saved before its frame counts as processed, the second after it.
        if (
            map_file.exists()
            and len(json.loads(slam_bof("query", map_file, "--json").stdout or "[]")) > 1
        ):
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    said = re.fullmatch(r"interrupted after (\d+) frames; go on with: slam-bof (.*)\n", err)
    assert said, err
    assert 0 < int(said[1]) < 3000
    assert shlex.split(said[2]) == [
        "run",
        str(sequence),
        "--resume",
        str((out / "latest").resolve()),
    ]
    assert json.loads(slam_bof("query", map_file, "--json").stdout)
