"""The script that tells what an atlas costs and finds, on a sequence of a few frames."""

import argparse
import json

import numpy as np
import pytest

from slam_bof.bof import describe_constellation


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("measure_atlas")


def test_the_table_counts_what_is_found_among_distractors(script, write_turn, tmp_path, capsys):
    yaws = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.45, 0.25, 0.05, 0.15, 0.35, 0.55]
    write_turn(tmp_path / "room" / "seq-01", yaws)
    arguments = argparse.Namespace(
        sequences=[tmp_path / "room" / "seq-01"],
        maps=[1, 5],
        keyframes=20,
        every=1,
        out=tmp_path / "out",
        max_frames=None,
        json=True,
        markdown=False,
    )
    script["measure"](arguments)
    alone, among = map(json.loads, capsys.readouterr().out.splitlines())
    assert (alone["maps"], among["maps"]) == (1, 5)
    assert among["keyframes"] == alone["keyframes"] + 80
    for row in (alone, among):
        assert (row["queries"], row["near"], row["wrong"]) == (6, 6, 0)
        assert row["answered"] == row["three"] >= row["first"]
    assert alone["first"] == alone["answered"] == 1.0
    assert among["first"] >= 4 / 6  # two queries are more like one of the 80 distractors
    assert 0 < alone["gb"] < among["gb"]


def test_distractors_are_like_views_but_none_of_them(script, box_room_frame):
    one = describe_constellation(box_room_frame, np.array([0.0, 1.0, 0.0]))
    copies = script["distractors"]([one.bofs], 3, 40, np.random.default_rng(0))
    assert [len(copy.ids) for copy in copies] == [len(copy.index) for copy in copies] == [40] * 3
    for copy in copies:
        counts = [len(copy.index.bofs(k).slices) for k in range(40)]
        assert np.mean(counts) == pytest.approx(len(one), rel=0.2)
    # Mirrored: what stood to the right stands to the left.
    right_m = np.concatenate([copies[0].index.bofs(k).centroids_m.real for k in range(40)])
    shift = right_m.mean() + one.bofs.centroids_m.real.mean()
    assert abs(shift) < 0.1
