"""The script that measures bags by the number of layers, on rooms of a few frames."""

import json

from labelled_boxes import SIZES_M, write_box

from slam_bof.datasets import frames_of, open_labelled
from slam_bof.evaluation import compare_methods, make_methods, split_at_random


def test_each_number_of_layers_is_a_row(load_script, write_turn, tmp_path, monkeypatch, capsys):
    script = load_script("measure_layers")
    for label in SIZES_M:
        write_box(tmp_path / label / "seq-01", label)
    labels = [f"--label={label}={tmp_path / label / 'seq-01'}" for label in SIZES_M]
    room = tmp_path / "room" / "seq-01"
    write_turn(room, [0.3 * k for k in range(8)])
    arguments = ["measure_layers", str(room), "--train", str(room), *labels, "--layers", "3", "20"]
    monkeypatch.setattr("sys.argv", [*arguments, "--words", "8", "--every", "1", "--json"])
    assert script["main"]() == 0
    few, more = map(json.loads, capsys.readouterr().out.splitlines())
    assert (few["n_layers"], more["n_layers"]) == (3, 20)
    assert set(few) == set(script["COLUMNS"])
    assert min(few["bytes"], more["bytes"]) > 0
    labelled = [q for name in SIZES_M for q in open_labelled(name, tmp_path / name / "seq-01")]
    split = split_at_random(frames_of(labelled), seed=0)
    (result,), _ = compare_methods(split, make_methods(["bof"], n_words=8))
    assert more["holdout"] == result.scores.accuracy
