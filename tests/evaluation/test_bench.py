"""The bench end to end on a few frames: what it counts and how it adds up, not how fast it is."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof import evaluation as benches
from slam_bof.cli import app
from slam_bof.core import open_dataset
from slam_bof.evaluation.cost import Cost, one_thread
from slam_bof.evaluation.index_benchmark import measure_recall
from slam_bof.geometry import se3
from slam_bof.types import Bag, Trajectory

N_FRAMES = 12


@pytest.fixture(scope="module")
def sequence(tmp_path_factory, write_turn):
    """Views of a room in 7-Scenes layout, with speckle for colour."""
    folder = tmp_path_factory.mktemp("bench") / "room" / "seq-01"
    write_turn(folder, [0.4 * number for number in range(N_FRAMES)])
    for number in range(N_FRAMES):
        noise = np.random.default_rng(number).integers(0, 256, (60, 80, 3)).astype(np.uint8)
        file = folder / f"frame-{number:06d}.color.png"
        cv2.imwrite(str(file), cv2.resize(noise, (320, 240)))
    return folder


@pytest.fixture(scope="module")
def figures(sequence):
    told = []
    found = benches.run_bench(
        [open_dataset(sequence)],
        n_words=8,
        index_sizes=(100,),
        on_progress=lambda what, done, total: told.append((done, total)),
    )
    assert all(0 <= done <= total for done, total in told)
    return found


def test_every_method_sees_every_frame(figures):
    assert figures["frames"] == N_FRAMES
    assert len(figures["classes"]) == 5
    assert list(figures["methods"]) == ["BOF 3 layers", "BOF 20 layers", "SIFT", "ORB"]
    for column in figures["methods"].values():
        assert column["samples"] == column["descriptors"] > 0
        assert column["describe_ms"] > 0
    assert figures["decode_ms"] > 0
    assert json.loads(json.dumps(figures)) == figures


def test_sums_are_the_papers(figures):
    for column in figures["methods"].values():
        for table in (column["process_cpu_s"], column["process_wall_s"]):
            assert table["7"] == pytest.approx(table["2"] + table["4"])
            assert table["8"] == pytest.approx(table["3"] + table["5"])
            assert table["9"] == pytest.approx(table["2"] + table["4"] + table["6"])


def test_bytes_are_those_of_the_descriptors(figures):
    values = {"BOF 3 layers": 180 * 4, "BOF 20 layers": 180 * 4, "SIFT": 128 * 4, "ORB": 32}
    for name, column in figures["methods"].items():
        assert column["descriptor_bytes"] == column["descriptors"] * values[name]
    packed = figures["methods"]["BOF 20 layers"]
    assert packed["packed_bytes"] == packed["descriptors"] * 32
    assert packed["packed_words_kept"] > 0.8


def test_the_index_is_timed_full(figures):
    assert list(figures["index"]) == ["100"]
    assert 8 <= figures["index"]["100"]["bytes_per_keyframe"] < 8 * 8 * 3


def test_without_colour_sift_and_orb_are_left_out(sequence, tmp_path):
    plain = tmp_path / "room" / "seq-02"
    plain.mkdir(parents=True)
    for file in sequence.glob("*.depth.png"):
        (plain / file.name).write_bytes(file.read_bytes())
    arguments = ["bench", "--data", str(plain), "--words", "8", "--index-size", "10"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "SIFT is left out: no colour images in room/seq-02." in result.stdout
    assert "Table 7" in result.stdout
    assert "Table 8" not in result.stdout


def test_several_sequences_are_a_class_each(sequence):
    arguments = ["bench", "--frames", "10", "--words", "8", "--index-size", "10", "--json"]
    data = ["--data", str(sequence)]
    copy = sequence.parent.parent / "other" / "seq-01"
    copy.mkdir(parents=True)
    for file in sequence.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    result = CliRunner().invoke(app, [*arguments, *data, "--data", str(copy)])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["classes"] == ["other/seq-01", "room/seq-01"]
    assert found["frames"] == 20
    assert found["methods"]["BOF 3 layers"]["recall"] is None


def test_a_cost_adds_up_its_calls():
    cost = Cost()
    for _ in range(3):
        with cost.measure():
            sum(range(100_000))
    assert len(cost.calls_s) == 3
    assert cost.cpu_s == pytest.approx(sum(cost.calls_s))
    assert 0 < cost.median_ms <= 1e3 * cost.cpu_s
    assert (cost + cost).wall_s == 2 * cost.wall_s


def test_threads_are_given_back():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_recall_counts_old_frames_of_the_same_place_only():
    def bag(word):
        return Bag(np.array([word], np.int32), np.ones(1, np.float32))

    indices = [0, 50, 150, 200]
    poses = np.tile(np.eye(4), (201, 1, 1))
    poses[50:150] = se3.exp(np.array([0, 0, 0, 5.0, 0, 0]))
    reference = Trajectory(np.arange(201) / 30, poses)
    # 150 and 200 come back to 0 (150 is too young for 200), 50 to none.
    bags = [bag(0), bag(1), bag(0), bag(1)]
    recall = measure_recall(bags, indices, reference, 2)
    assert recall["1"] == 0.5
    assert recall["5"] == 1.0
