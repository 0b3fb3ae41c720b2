"""The script that plays a sequence forth and back, on one of a few frames."""

import argparse
import csv
import json
import signal
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("measure_growth")


@pytest.fixture
def arguments(write_turn, tmp_path):
    write_turn(tmp_path / "room" / "seq-01", [0.0, 0.2, 0.4, 0.6])
    return argparse.Namespace(
        sequence=tmp_path / "room" / "seq-01",
        config="indoor",
        assignments=["keyframes.policy=every", "keyframes.every=1", "model=synthetic"],
        frames=12,
        seed=0,
        max_frames=None,
        map=tmp_path / "map.db",
        log=tmp_path / "log.csv",
        out=None,
        json=True,
        markdown=False,
    )


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_every_keyframe_is_logged_and_counted_by_tenths(script, arguments, capsys):
    script["measure"](arguments)
    said = capsys.readouterr()
    *tenths, slope = map(json.loads, said.out.splitlines())
    rows = rows_of(arguments.log)
    assert [int(row["frame"]) for row in rows] == list(range(12))
    assert len(tenths) == 10
    assert slope["keyframe"] == "slope per 1000"
    assert tenths[-1]["active"] == int(rows[-1]["active"])
    assert float(rows[-1]["map_mb"]) == pytest.approx(1e-6 * arguments.map.stat().st_size, rel=0.9)
    assert all(float(row["all"]) >= float(row["verify"]) for row in rows)
    assert "12 frames, 12 keyframes" in said.err
    assert "ATE 0.0" in said.err


def test_ctrl_c_ends_the_tour_where_it_is(script, arguments):
    before, seen = signal.getsignal(signal.SIGINT), []
    for index in script["until_interrupted"](script["forth_and_back"](12, 4)):
        seen.append(index)
        if len(seen) == 6:
            signal.raise_signal(signal.SIGINT)
    assert seen == [0, 1, 2, 3, 2, 1]
    assert signal.getsignal(signal.SIGINT) is before
