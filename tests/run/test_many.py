"""Several sequences: a folder each, the same files whatever the number of workers."""

import json
import sys
from functools import partial
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof.cli.app import app
from slam_bof.cli.inputs import open_sequence
from slam_bof.core import cluster as cluster_module, on_cluster
from slam_bof.run import RunOptions, run_sequences
from slam_bof.slam import preset

FILES = ("trajectory_optimized_tum.txt", "trajectory_odometry_tum.txt", "pose_graph.g2o")


@pytest.fixture(scope="module")
def sequences(write_turn, tmp_path_factory):
    """Two short sequences with the same folder names, and one that is none."""
    folder = tmp_path_factory.mktemp("many")
    paths = []
    for name, yaws in (("a", np.arange(0.0, 0.6, 0.05)), ("b", np.arange(1.0, 1.6, 0.05))):
        paths.append(folder / name / "room" / "seq-01")
        write_turn(paths[-1], yaws.tolist())
    broken = folder / "broken"
    broken.mkdir()
    return [paths[0], broken, paths[1]]


def test_files_do_not_depend_on_the_number_of_workers(sequences, tmp_path):
    config = preset("indoor")
    open_ = partial(open_sequence, choice=config.dataset, frames=None, quiet=True)
    found = [
        list(run_sequences(sequences, open_, config, tmp_path / str(n), RunOptions(10), n_jobs=n))
        for n in (1, 2)
    ]
    for one, other in zip(*found, strict=True):
        assert one.sequence == other.sequence
        if one.result is None:
            assert other.result is None
            assert one.error == other.error
            assert str(sequences[1]) in one.error
            continue
        assert one.result.metrics["n_frames"] == 10
        assert one.result.folder.parent.name == other.result.folder.parent.name
        for name in FILES:
            content = [(run.result.folder / name).read_bytes() for run in (one, other)]
            assert content[0] == content[1]
            assert content[0]
    names = [run.result.folder.parent.name for run in found[0] if run.result is not None]
    assert names == ["room-seq-01", "room-seq-01-2"]


def test_the_command_runs_the_others_where_one_fails(sequences, tmp_path):
    words = ["run", *map(str, sequences), "--out", str(tmp_path), "--max-frames", "8", "--json"]
    done = CliRunner().invoke(app, [*words, "--quiet"])
    assert done.exit_code == 1
    first, failed, last = json.loads(done.stdout)
    assert (first["n_frames"], last["n_frames"]) == (8, 8)
    assert failed["error"]
    assert "1 of 3 sequences failed" in done.stderr
    for option in ("--map", "--resume"):
        done = CliRunner().invoke(app, [*words, option, str(tmp_path / "map.db")])
        assert done.exit_code == 2
        assert f"found 3 sequences with {option}" in done.stderr


DIES_ONCE = """
import os
from pathlib import Path

def open_dying(sequence, *, mark, inner):
    # Kills its worker the first time that it opens the last sequence.
    if "b" in Path(sequence).parts and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), 9)
    return inner(sequence)
"""


def test_a_cluster_makes_the_same_files_and_survives_a_killed_worker(sequences, tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs the extra dask")
    config = preset("indoor")
    open_ = partial(open_sequence, choice=config.dataset, frames=None, quiet=True)
    scope: dict[str, Any] = {"__name__": "__main__"}  # which is pickled by value
    exec(DIES_ONCE, scope)
    mark = tmp_path / "killed"
    dying = partial(scope["open_dying"], mark=str(mark), inner=open_)
    two = sequences[::2]
    local = list(run_sequences(two, open_, config, tmp_path / "local", RunOptions(6)))
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**options) as cluster,
        on_cluster(cluster.scheduler_address),
    ):
        far = list(run_sequences(two, dying, config, tmp_path / "far", RunOptions(6), n_jobs=None))
    assert mark.exists()
    for one, other in zip(local, far, strict=True):
        assert other.result is not None, other.error
        for name in FILES:
            assert (one.result.folder / name).read_bytes() == (
                other.result.folder / name
            ).read_bytes()


def test_a_scheduler_that_is_missing_is_named(sequences, tmp_path, monkeypatch):
    words = ["run", *map(str, sequences[::2]), "--out", str(tmp_path), "--scheduler"]
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "distributed", None)
        done = CliRunner().invoke(app, [*words, "tcp://127.0.0.1:1"])
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "slam-bof[dask]" in done.stderr
    done = CliRunner().invoke(app, ["run", str(sequences[0]), "--scheduler", "tcp://127.0.0.1:1"])
    assert done.exit_code == 2
    pytest.importorskip("distributed", reason="needs the extra dask")
    monkeypatch.setattr(cluster_module, "TIMEOUT_S", 1)
    done = CliRunner().invoke(app, [*words, "tcp://127.0.0.1:1"])
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "tcp://127.0.0.1:1: found no scheduler of Dask" in done.stderr
