"""What the measuring scripts share."""

import argparse
import json
import sys

import pytest

from slam_bof.errors import DatasetError

COLUMNS = {"name": "sequence", "ate_m": "ATE m", "kept": "kept"}
ROW = {"name": "twin", "ate_m": 0.012344, "kept": True, "extra": 3}


@pytest.fixture(scope="module")
def shared(load_script):
    return load_script("_measure.py")


def table(shared, form):
    forms = {"json": form == "json", "markdown": form == "markdown"}
    return shared["Table"](COLUMNS, argparse.Namespace(**forms))


def test_a_text_table_has_its_heading_once(shared, capsys):
    rows = table(shared, "text")
    rows.row(ROW)
    rows.row({"name": "flat"})
    heading, twin, flat = capsys.readouterr().out.splitlines()
    assert heading.split() == ["sequence", "ATE", "m", "kept"]
    assert twin.split() == ["twin", "0.01234", "yes"]
    assert flat.split() == ["flat", "-", "-"]
    assert len(heading) == len(twin) == len(flat)


def test_a_new_markdown_table_begins_after_a_note(shared, capsys):
    rows = table(shared, "markdown")
    rows.note("120 frames")
    rows.row(ROW)
    lines = capsys.readouterr().out.strip().splitlines()
    assert lines == [
        "120 frames",
        "",
        "| sequence | ATE m | kept |",
        "| --- | --- | --- |",
        "| twin | 0.01234 | yes |",
    ]


def test_json_has_all_figures_and_nothing_else(shared, capsys):
    rows = table(shared, "json")
    rows.note("120 frames")
    rows.row(ROW)
    printed = capsys.readouterr()
    assert json.loads(printed.out) == ROW
    assert printed.err == "120 frames\n"


def test_a_mistake_is_one_line(shared, monkeypatch, capsys):
    def measure(arguments):
        raise DatasetError("seq-01: found nothing, expected frames")

    monkeypatch.setattr(sys, "argv", ["measure_it"])
    assert shared["run"](shared["make_parser"]("Measure it."), measure) == 1
    assert capsys.readouterr().err == "error: seq-01: found nothing, expected frames\n"


def test_frames_are_limited(shared, write_turn, tmp_path):
    folder = tmp_path / "room" / "seq-01"
    write_turn(folder, [0.0, 0.1, 0.2])
    for n_frames, expected in ((None, 3), (2, 2), (9, 3)):
        arguments = argparse.Namespace(max_frames=n_frames)
        assert len(shared["open_sequence"](folder, arguments)) == expected
    with pytest.raises(ValueError, match="--max-frames must be at least 1, got 0"):
        shared["open_sequence"](folder, argparse.Namespace(max_frames=0))
    assert shared["true_poses"](shared["open_sequence"](folder, arguments)).shape == (3, 4, 4)


def test_configurations_are_presets_with_assignments(shared):
    parser = shared["make_parser"]("Measure it.")
    shared["add_config"](parser)
    arguments = parser.parse_args(["--config", "paper", "--set", "seed=3"])
    assert shared["load_config"](arguments, ["loops.top_k=2"]).loops.top_k == 2
    assert shared["load_config"](arguments).seed == 3
