"""Place recognition judged end to end, on a sequence that goes round a room twice."""

import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.evaluation.place_methods import hamming_similarities, row_similarities

N_ROUND = 12


@pytest.fixture(scope="module")
def twice_round(tmp_path_factory, write_turn):
    folder = tmp_path_factory.mktemp("retrieval") / "room" / "seq-01"
    yaws = [2 * np.pi * number / N_ROUND for number in range(2 * N_ROUND)]
    write_turn(folder, yaws, [0.0] * N_ROUND + [0.02] * N_ROUND)
    for file in folder.glob("*.color.png"):
        file.unlink()
    return folder


def evaluate(*arguments):
    return CliRunner().invoke(app, ["evaluate", "places", "-q", *map(str, arguments)])


def test_coming_back_is_found(twice_round):
    result = evaluate(twice_round, "--every", 1, "--min-age", N_ROUND, "--json")
    assert result.exit_code == 0, result.output
    rows = {row["descriptor"]: row for row in json.loads(result.stdout)}
    recognisers = {"recogniser", "recogniser, unaligned"}
    assert set(rows) == recognisers | set(registry.names("descriptors"))
    for name in ("orb", "sift"):
        assert rows[name]["left_out"] == "needs sequences to learn words of"
    assert rows["gist"]["left_out"] == "no colour images in room/seq-01"
    for name in ("bof", "ferns", "gist-depth", "occupancy", "thumbnail", *recognisers):
        for truth in ("pose", "overlap"):
            assert rows[name][truth]["n_queries"] == N_ROUND
        assert rows[name]["describe_ms"] > 0
        assert rows[name]["query_ms"] > 0
        assert rows[name]["bytes_per_frame"] > 0
    # From two centimetres aside, the depth image is all but the same.
    for name in ("ferns", "gist-depth", "occupancy", "thumbnail"):
        assert rows[name]["pose"]["recall_at"]["1"] == 1.0
    # At thirty degrees a frame the odometry is lost, and with it how the camera is held.
    for name in recognisers:
        assert rows[name]["pose"]["recall_at"]["1"] > 0.7
    assert rows["bof"]["pose"]["recall_at"]["5"] > 0.6


def test_parameters_of_the_recogniser_can_be_set(twice_round):
    arguments = ("--every", 1, "--min-age", N_ROUND, "--descriptors", "recogniser", "--json")
    set_ = ("--set", "loops.recogniser.n_aligned=0", "--set", "loops.recogniser.n_followed=0")
    unaligned = json.loads(evaluate(twice_round, *arguments, *set_).stdout)
    # Nothing is aligned, so that both rows are of the search index.
    first, second = (
        {kind: row[kind]["recall_at"] for kind in ("pose", "overlap")} for row in unaligned
    )
    assert first == second
    assert "n_alligned" in refusal(twice_round, "--set", "loops.recogniser.n_alligned=0")


def without_times(rows):
    return [{name: row[name] for name in row if not name.endswith("_ms")} for row in rows]


def test_recall_does_not_depend_on_the_number_of_workers(twice_round, tmp_path):
    other = shutil.copytree(twice_round, tmp_path / "room" / "seq-02")
    (other / "frame-000003.depth.png").write_bytes((other / "frame-000009.depth.png").read_bytes())
    arguments = (twice_round, other, "--every", 2, "--min-age", N_ROUND, "--json")
    arguments += ("--descriptors", "ferns,thumbnail,gist", "--misses")
    one, two = (
        json.loads(evaluate(*arguments, tmp_path / f"{n}.html", "--jobs", n).stdout) for n in (1, 2)
    )
    assert without_times(one) == without_times(two)
    assert [row["sequence"] for row in one] == ["room/seq-01"] * 3 + ["room/seq-02"] * 3
    assert without_times(one)[:3] != [
        row | {"sequence": "room/seq-01"} for row in without_times(one)[3:]
    ]
    pages = [(tmp_path / f"{n}.html").read_bytes() for n in (1, 2)]
    assert pages[0] == pages[1]


def test_places_are_evaluated_on_a_cluster(twice_round):
    distributed = pytest.importorskip("distributed", reason="needs the extra dask")
    arguments = (twice_round, "--every", 1, "--min-age", N_ROUND, "--json")
    arguments += ("--descriptors", "thumbnail")
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    here = evaluate(*arguments)
    with distributed.LocalCluster(**options) as cluster:
        there = evaluate(*arguments, "--scheduler", cluster.scheduler_address)
    assert without_times(json.loads(here.stdout)) == without_times(json.loads(there.stdout))
    assert "found no scheduler" in refusal(*arguments, "--scheduler", "tcp://127.0.0.1:1")


def test_words_can_be_learnt_of_other_sequences(twice_round):
    arguments = ("--every", 1, "--min-age", N_ROUND, "--descriptors", "bof,sift")
    result = evaluate(twice_round, *arguments, "--train", twice_round, "--words", 16)
    assert result.exit_code == 0, result.output
    assert "Truth by overlap" in result.stdout
    assert "sift is left out: no colour images in room/seq-01" in result.stdout


def test_curves_and_misses_are_written(twice_round, tmp_path):
    file = tmp_path / "curves" / "places.html"
    arguments = ("--every", 1, "--min-age", N_ROUND, "--descriptors", "ferns,thumbnail")
    misses = tmp_path / "misses.html"
    result = evaluate(twice_round, *arguments, "--curves", file, "--misses", misses, "--json")
    assert result.exit_code == 0, result.output
    assert "truth by overlap" in file.read_text("utf-8")
    assert f"0 of {N_ROUND} queries got a wrong answer." in misses.read_text("utf-8")
    ferns, _ = json.loads(result.stdout)
    curve = np.array(ferns["pose"]["curve"])
    assert curve[-1, 0] == ferns["pose"]["recall_at"]["1"]
    assert (np.diff(curve[:, 0]) >= 0).all()


def refusal(*arguments):
    result = evaluate(*arguments)
    assert result.exit_code == 1, result.output
    *_, last = result.stderr.splitlines()
    assert last.startswith("error: ")
    return last


def test_bad_input_is_one_line(twice_round, tmp_path):
    assert "no descriptors plug-in 'surf'; installed: bof, bof-" in refusal(
        twice_round, "--descriptors", "surf"
    )
    few = refusal(twice_round, "--descriptors", "bof", "--train", twice_round, "--words", 100000)
    assert "descriptors of bof, expected at least 100000" in few
    blind = tmp_path / "room" / "seq-02"
    blind.mkdir(parents=True)
    for file in twice_round.glob("*.depth.png"):
        (blind / file.name).write_bytes(file.read_bytes())
    assert "room/seq-02: found no ground truth" in refusal(blind)


def test_likeness_of_codes():
    one, other, none = (
        np.array(rows, np.uint8).reshape(-1, 2) for rows in ([[255, 0]], [[255, 1], [0, 0]], [])
    )
    scores = hamming_similarities([one, none, other])
    assert scores.tolist() == [
        [1.0, 0.0, pytest.approx(15 / 16)],
        [0.0, 0.0, 0.0],
        [pytest.approx((15 / 16 + 8 / 16) / 2), 0.0, 1.0],
    ]


def test_likeness_of_rows():
    rows = np.array([[3, 4, 0], [0, 0, 5], [3, 4, 5]], np.uint8)
    cosine = row_similarities(rows, "cosine")
    np.testing.assert_allclose(np.diag(cosine), 1.0, rtol=1e-6)
    assert cosine[0, 1] == 0.0
    assert row_similarities(rows, "equal")[2].tolist() == pytest.approx([2 / 3, 1 / 3, 1.0])
    assert row_similarities(rows, "l1")[0].tolist() == [0.0, -4.0, pytest.approx(-5 / 3)]
    with pytest.raises(ValueError, match="comparison must be cosine, l1 or equal, got 'bag'"):
        row_similarities(rows, "bag")
