"""A short run of the fuzzer, and that it would notice."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

FUZZ = ROOT / "scripts" / "fuzz"
FAULTS = ("implausible", "traceback", "crash", "hang", "memory")


def test_no_reader_fails_on_broken_files() -> None:
    """The readers that are quick to prepare; ``scripts/fuzz`` has more."""
    readers = ["map", "atlas", "config", "archive", "server", "sequence", "image"]
    readers += ["bag", "table", "trajectory", "value", "closer", "recogniser"]
    command = [sys.executable, str(FUZZ), "--json", "--cases", "300", "--seed", "7"]
    done = subprocess.run([*command, "--readers", *readers], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = {row["reader"]: row for row in map(json.loads, done.stdout.splitlines())}
    assert set(rows) == {*readers, "all"}
    for row in rows.values():
        assert row["refused"] + row["accepted"] == row["cases"]
        assert row["refused"] > 0 or row["reader"] in ("closer", "recogniser")


READ = {
    "traceback": "raise KeyError('x')",
    "implausible": "raise AssertionError('far away')",
    "crash": "import os, signal; os.kill(os.getpid(), signal.SIGKILL)",
    "hang": "import time; time.sleep(99)",
    "memory": "bytes(5 << 30)",
    "accepted": "pass",
}


@pytest.mark.parametrize("outcome", READ)
def test_every_fault_is_noticed(
    outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    script = runpy.run_path(str(FUZZ))
    if outcome == "hang":
        monkeypatch.setitem(script["work"].__globals__, "HANG_S", 1)
    reader = script["Reader"](
        1.0,
        lambda place: None,
        lambda place, case, rng: (case / "file").write_text("broken"),
        lambda place, case: exec(READ[outcome]),
    )
    counts = script["fuzz"]("x", reader, range(2), 0, tmp_path, tmp_path / "kept")
    assert counts == {outcome: 2}
    if outcome != "accepted":
        assert f"x --seed 0, case 1: {outcome}" in capfd.readouterr().err
        assert (tmp_path / "kept" / "x-0-1" / "file").read_text() == "broken"


def test_a_long_run_can_be_done_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Parts come to the cases of the whole."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    script = runpy.run_path(str(FUZZ))

    def read(place: Path, case: Path) -> None:
        raise RuntimeError((case / "number").read_text())

    reader = script["Reader"](
        1.0,
        lambda place: None,
        lambda place, case, rng: (case / "number").write_text(str(rng.random())),
        read,
    )
    said = []
    for cases in (range(6), range(2), range(2, 6)):
        script["fuzz"]("x", reader, cases, 5, tmp_path, None)
        said.append(capfd.readouterr().err)
    assert said[0] == said[1] + said[2]
    assert said[0].count("\n") == 6
