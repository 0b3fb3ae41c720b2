"""The script that tells how well frames are found again, on a sequence of a few frames."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.places import Localization
from slam_bof.synthetic import Scene3D
from slam_bof.synthetic.tour import camera_poses
from slam_bof.synthetic.writer import write_sequence


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("measure_localization")


@pytest.fixture
def arguments(room, standpoint, tmp_path):
    """Six views with small steps between them make a map, and two of what they show ask."""
    places = [
        (0, 0, 0),
        (6, 2, 0),
        (9, 7, 2),
        (6, 12, 6),
        (2, 9, 11),
        (0, 3, 9),
        (2, 3, 2),
        (6, 8, 5),
    ]
    yaws = np.array([0.0, 0.06, 0.12, 0.18, 0.24, 0.3, 0.05, 0.2])
    positions = np.array([*standpoint, 1.3]) + 0.03 * np.array(places)
    poses = np.array([camera_poses(at, yaw, 0.1) for at, yaw in zip(positions, yaws, strict=True)])
    write_sequence(tmp_path / "room" / "seq-01", Scene3D(room.mesh), poses)
    return argparse.Namespace(
        sequence=tmp_path / "room" / "seq-01",
        map_frames="0:6",
        query_frames="6:8",
        every=5,
        queries=None,
        elsewhere=False,
        config="indoor",
        assignments=[],
        max_frames=None,
        json=True,
        markdown=False,
        verbose=True,
    )


def test_the_table_counts_what_is_found(script, arguments, capsys):
    script["measure"](arguments)
    printed = capsys.readouterr()
    row = json.loads(printed.out)
    assert (row["n_queries"], row["n_seeing"], row["n_answered"], row["n_wrong"]) == (2, 2, 2, 0)
    assert row["within_10"] == 1.0
    answers = [line.split(":")[0] for line in printed.err.splitlines() if line.startswith("frame")]
    assert answers == [f"frame {k}, sees the map" for k in (6, 7)]


def test_an_answer_elsewhere_is_wrong(script, arguments, capsys):
    arguments.queries, arguments.elsewhere = arguments.sequence, True
    script["measure"](arguments)
    row = json.loads(capsys.readouterr().out)
    assert (row["n_answered"], row["n_wrong"]) == (2, 2)
    assert row["within_10"] is None


def test_a_sequence_without_truth_is_refused_in_words(script, arguments):
    for file in Path(arguments.sequence).glob("*.pose.txt"):
        file.unlink()
    with pytest.raises(DatasetError, match="found no ground truth"):
        script["measure"](arguments)


@pytest.mark.parametrize(
    ("text", "expected"),
    [(None, range(3)), ("2:4", range(2, 4)), (":6:2", range(0, 6, 2)), ("8:", range(8, 10))],
)
def test_frames_are_chosen_as_slices(script, text, expected):
    assert script["parse_range"](text, 10, range(3)) == expected


@pytest.mark.parametrize(
    ("text", "reason"), [("5", "expected START:STOP"), ("20:30", "no frame of 10")]
)
def test_frames_that_are_none_are_refused_in_words(script, text, reason):
    with pytest.raises(ValueError, match=reason):
        script["parse_range"](text, 10, range(3))


def test_errors_of_no_answer_are_none(script):
    here, nowhere = Localization(np.eye(4), 0), Localization(reason="not known")
    truth = [None, np.eye(4), None]
    answers = script["Answers"]([nowhere, here, here], [], [], truth)
    off_m, off_deg = answers.errors()
    assert np.isnan(off_m[0])
    assert (off_m[1], off_deg[1]) == (0.0, 0.0)
    assert (off_m[2], off_deg[2]) == (np.inf, 180.0)
