"""The script that prints Table 10, on a sequence of a few frames."""

import argparse

from slam_bof.core import registry
from slam_bof.loops import LoopParams
from slam_bof.slam import config


def test_each_variation_is_a_row_and_a_matrix(load_script, write_turn, tmp_path, capsys):
    script = load_script("measure_loops")
    write_turn(tmp_path / "room" / "seq-01", [0.0, 0.6, 1.2, 0.0, 0.6])
    paper = config.preset("paper")
    paper = paper.model_copy(update={"loops": paper.loops.model_copy(update={"min_age_s": 0.1})})
    out = tmp_path / "figures"
    out.mkdir()
    table = script["Table"](script["COLUMNS"], argparse.Namespace(json=False, markdown=False))
    dataset = registry.open_dataset(tmp_path / "room" / "seq-01")
    script["measure_dataset"](dataset, paper, table, out)
    first, heading, *rows = capsys.readouterr().out.splitlines()
    assert first == "5 frames, 2 of them revisit a place"
    assert [row[:2] for row in rows] == [f"{letter}:" for letter in script["VARIATIONS"]]
    assert {len(row) for row in rows} == {len(heading)}
    assert sorted(path.stem for path in out.iterdir()) == sorted(script["VARIATIONS"])


def test_variations_are_of_parameters_that_there_are(load_script):
    script = load_script("measure_loops")
    for variation in script["VARIATIONS"].values():
        LoopParams.model_validate(variation.changes)
    assert script["VARIATIONS"]["a"].changes == {}
