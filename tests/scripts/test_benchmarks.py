"""The script that runs the measurements behind the benchmarks page."""

import subprocess
import sys

import pytest
from conftest import ROOT

BENCHMARKS = ROOT / "scripts" / "benchmarks"


def benchmarks(*arguments):
    command = [sys.executable, str(BENCHMARKS), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_selection_is_measured_and_written(tmp_path):
    out = tmp_path / "figures.md"
    done = benchmarks("turns", "--quick", "--work", tmp_path, "--out", out)
    assert done.returncode == 0, done.stderr
    text = out.read_text("utf-8")
    assert text.startswith("## Odometry on quick turns\n\nVersion ")
    assert "scripts/measure_turns --rooms=1 --angle=20 --markdown\n" in text
    assert "| room | error m | error deg | CPU ms |\n| --- | --- | --- | --- |\n| office | " in text
    assert text.count("## ") == 1


def test_the_quick_sequence_has_revisits_for_the_index(tmp_path):
    done = benchmarks("constellation", "--quick", "--work", tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "benchmarks.md").read_text("utf-8")
    assert "--sizes 50 --min-age=20 --markdown\n" in text
    assert "\n| 50 | " in text


def test_missing_data_leave_a_measurement_out(tmp_path):
    done = benchmarks("run", "--data", tmp_path / "none", "--work", tmp_path)
    assert done.returncode == 1
    assert "redkitchen/seq-01: found no such sequence; --data says where" in done.stderr
    assert "Left out: " in (tmp_path / "benchmarks.md").read_text("utf-8")


def test_an_unknown_measurement_is_refused(tmp_path):
    done = benchmarks("speed", "--work", tmp_path)
    assert done.returncode == 2
    assert "found speed, expected some of --list" in done.stderr


def test_measurements_are_listed():
    done = benchmarks("--list")
    assert done.returncode == 0
    assert "localization   Localization of single frames" in done.stdout


def test_every_measuring_script_is_run(load_script):
    titles = load_script("benchmarks")["BENCHMARKS"]
    text = BENCHMARKS.read_text("utf-8")
    for path in sorted(BENCHMARKS.parent.glob("measure_*")):
        assert path.name in text, f"{path.name} is behind no section"
    assert len({benchmark.title for benchmark in titles.values()}) == len(titles)


@pytest.mark.parametrize("name", ["redkitchen", "lab", "office", "iphone_meeting"])
def test_recorded_sequences_are_looked_for_and_never_made(load_script, tmp_path, name):
    script = load_script("benchmarks")
    data = script["Data"](tmp_path / "data", tmp_path, False)
    with pytest.raises(script["UnavailableError"], match=f"{name}.*found no such sequence"):
        data.sequence(name)
