"""What the bench makes of odd sequences, and how its parts keep and count what they are given."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from conftest import CAMERA
from typer.testing import CliRunner, Result

from slam_bof.cli import app
from slam_bof.cli.bench import PROCESSES
from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof.evaluation import run_bench
from slam_bof.evaluation.descriptor_runs import METHODS, DescriptorRun, choose_frames
from slam_bof.evaluation.index_benchmark import measure_index
from slam_bof.geometry import se3
from slam_bof.types import Bag

N_FRAMES = 12
N_WORDS = 32
NAMES = [method.name for method in METHODS]


def cluttered_depth(random: np.random.Generator) -> np.ndarray[Any, Any]:
    """Ellipses floating before a wall: some contours in every layer."""
    depth = np.full((CAMERA.height, CAMERA.width), 4000, np.uint16)
    for z_mm in sorted(random.integers(800, 3900, 12).tolist(), reverse=True):
        centre = random.integers((10, 10), (CAMERA.width - 10, CAMERA.height - 10)).tolist()
        axes = random.integers(8, 30, 2).tolist()
        angle = float(random.integers(180))
        cv2.ellipse(depth, centre, axes, angle, 0, 360, z_mm, cv2.FILLED)
    return depth


def write_sequence(
    folder: Path, *, seed: int, color: bool = True, n_frames: int = N_FRAMES
) -> Path:
    folder.mkdir(parents=True)
    random = np.random.default_rng(seed)
    for number in range(n_frames):
        stem = folder / f"frame-{number:06d}"
        cv2.imwrite(f"{stem}.depth.png", cluttered_depth(random))
        speckle = random.integers(0, 256, (30, 40, 3)).astype(np.uint8)
        if color:
            image = cv2.resize(speckle, (160, 120), interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(f"{stem}.color.png", image)
        np.savetxt(f"{stem}.pose.txt", se3.exp(np.array([0, 0.1 * number, 0, 0, 0, 0])))
    return folder


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sequence(tmp_path_factory.mktemp("scenes") / "kitchen" / "seq-01", seed=0)


def bench(*folders: Path, **kwargs: Any) -> dict[str, Any]:
    datasets = [registry.open_dataset(folder) for folder in folders]
    return run_bench(datasets, n_words=N_WORDS, index_sizes=(200,), **kwargs)


@pytest.fixture(scope="module")
def figures(kitchen: Path) -> dict[str, Any]:
    return bench(kitchen)


def slam_bof(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_every_method_has_every_process(figures: dict[str, Any]) -> None:
    assert list(figures["methods"]) == NAMES
    assert figures["left_out"] == {}
    for column in figures["methods"].values():
        for key in ("process_cpu_s", "process_wall_s"):
            assert list(column[key]) == [str(number) for number in range(1, 10)]
            assert all(seconds > 0 for seconds in column[key].values())


def test_increases_are_from_bof_to_the_others(figures: dict[str, Any]) -> None:
    methods = figures["methods"]
    assert list(figures["increases"]) == [
        "BOF 3 layers to SIFT",
        "BOF 20 layers to SIFT",
        "BOF 3 layers to ORB",
        "BOF 20 layers to ORB",
    ]
    for pair, shares in figures["increases"].items():
        initial, final = (methods[name]["process_wall_s"]["9"] for name in pair.split(" to "))
        assert shares["wall_percent"]["9"] == pytest.approx(100 * (final / initial - 1))
        assert list(shares["cpu_percent"]) == [str(number) for number in range(1, 10)]


def test_memory_is_that_of_what_was_found(figures: dict[str, Any]) -> None:
    methods = figures["methods"]
    n_bytes = {"BOF 3 layers": 720, "BOF 20 layers": 720, "SIFT": 512, "ORB": 32}
    n_values = {"BOF 3 layers": 180, "BOF 20 layers": 180, "SIFT": 128, "ORB": 256}
    for name, column in methods.items():
        assert column["descriptor_bytes"] == column["descriptors"] * n_bytes[name] > 0
        n_words = column["words"]
        assert n_words == min(N_WORDS, column["descriptors"])
        assert column["codebook_bytes"] == 4 * n_words * (n_values[name] + 1)
        assert column["classifier_bytes"] > 100
        # A bag holds a word once, and each word costs an index and a weight.
        assert 0 < column["bag_bytes"] <= 8 * N_FRAMES * n_words + 4 * (N_FRAMES + 1)
    packed = methods["BOF 20 layers"]
    assert packed["packed_bytes"] == 32 * packed["descriptors"]
    assert packed["packed_words_kept"] > 0.9
    assert "packed_bytes" not in methods["SIFT"]


def test_few_descriptors_make_few_words(kitchen: Path) -> None:
    datasets = [registry.open_dataset(kitchen)]
    methods = run_bench(datasets, n_frames=4, n_words=100, index_sizes=())["methods"]
    few = methods["BOF 3 layers"]
    assert few["words"] == few["descriptors"] < 100
    assert methods["ORB"]["words"] == 100 < methods["ORB"]["descriptors"]


def test_the_same_seed_finds_the_same(kitchen: Path, figures: dict[str, Any]) -> None:
    again = bench(kitchen)
    for name in NAMES:
        for key in ("descriptors", "bag_bytes", "classifier_bytes"):
            assert again["methods"][name][key] == figures["methods"][name][key]


def test_one_sequence_is_cut_and_several_are_a_class_each(kitchen: Path, tmp_path: Path) -> None:
    office = write_sequence(tmp_path / "office" / "seq-02", seed=1, n_frames=4)
    one, two = (registry.open_dataset(folder) for folder in (kitchen, office))
    labels = [frame.label for frame in choose_frames([one])]
    assert labels == sorted(labels)
    assert [labels.count(label) for label in sorted(set(labels))] == [3, 2, 3, 2, 2]
    several = choose_frames([one, two], 3)
    assert [frame.index for frame in several] == [0, 6, 11, 0, 2, 3]
    assert [frame.label for frame in several] == ["kitchen/seq-01"] * 3 + ["office/seq-02"] * 3
    twice = choose_frames([two, two])
    assert twice[0].label != twice[-1].label


def test_a_method_that_finds_nothing_is_left_out(tmp_path: Path) -> None:
    blank = write_sequence(tmp_path / "blank" / "seq-01", seed=3, n_frames=6)
    for file in blank.glob("*.color.png"):
        cv2.imwrite(str(file), np.zeros((120, 160, 3), np.uint8))
    found = bench(blank)
    assert found["left_out"]["ORB"] == "0 descriptors in all frames"
    assert list(found["methods"]) == ["BOF 3 layers", "BOF 20 layers"]
    for file in blank.glob("*.depth.png"):
        cv2.imwrite(str(file), np.zeros((120, 160), np.uint16))
    nothing = bench(blank)
    assert (nothing["methods"], nothing["index"]) == ({}, {})
    assert list(nothing["left_out"]) == NAMES


def test_a_colour_image_that_is_missing_is_named(kitchen: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn" / "seq-01"
    shutil.copytree(kitchen, torn)
    (torn / "frame-000007.color.png").unlink()
    with pytest.raises(DatasetError, match="torn/seq-01: frame 7 has no colour image"):
        bench(torn)


def test_too_few_frames_are_refused(kitchen: Path) -> None:
    with pytest.raises(DatasetError, match="found 3 frames, expected at least 4"):
        choose_frames([registry.open_dataset(kitchen)], 3)


def test_samples_are_rows_of_what_was_found() -> None:
    random = np.random.default_rng(0)
    described = DescriptorRun(registry.build("descriptors", "sift"))
    parts = [random.integers(0, 256, (n, 128)).astype(np.float32) for n in (3, 0, 5)]
    for part in parts:
        described.keep(part)
    assert all(kept.dtype == np.uint8 for kept in described.values), "whole numbers fit in bytes"
    assert described.nbytes == 8 * 128 * 4
    np.testing.assert_array_equal(described.samples(8, seed=0), np.concatenate(parts))
    few = described.samples(4, seed=0)
    assert few.shape == (4, 128)
    rows = {row.tobytes() for row in np.concatenate(parts)}
    assert len({row.tobytes() for row in few} & rows) == 4


def test_fractions_are_kept_as_they_are() -> None:
    described = DescriptorRun(registry.build("descriptors", "bof"))
    part = np.random.default_rng(0).random((3, 180)).astype(np.float32)
    described.keep(part)
    np.testing.assert_array_equal(described.values[0], part)


def test_bits_become_zeros_and_ones() -> None:
    described = DescriptorRun(registry.build("descriptors", "orb"))
    described.keep(np.array([[1] + [0] * 30 + [128]], np.uint8))
    bits = described.samples(10, seed=0)
    assert bits.shape == (1, 256)
    assert np.flatnonzero(bits).tolist() == [7, 248]
    assert described.nbytes == 32


def one_word(word: int) -> Bag:
    return Bag(np.array([word], np.int32), np.ones(1, np.float32))


def test_the_index_is_as_large_as_asked() -> None:
    bags = [one_word(word) for word in range(8)]
    shown: list[tuple[str, int, int]] = []
    row = measure_index(bags, 25_000, 8, 0, lambda *progress: shown.append(progress))
    assert shown[-1][1:] == (25_000, 25_000)
    # Half of the words of two bags of one word each: one or two words of 8 bytes.
    assert 8 <= row["bytes_per_keyframe"] <= 2 * 8 * 1.25
    assert row["query_ms"] > 0


def test_the_command_prints_the_tables(kitchen: Path) -> None:
    options = ("--frames", 6, "--words", 16, "--index-size", 100, "--index-size", 150)
    result = slam_bof("bench", "--data", kitchen, *options)
    assert result.exit_code == 0, result.output
    for text in ("Table 7", "Table 8", "Table 9", "kitchen/seq-01: 6 frames", "3 segments"):
        assert text in result.stdout
    for process in PROCESSES:
        assert result.stdout.count(f"│ {process} ") == 2
    assert "Frames: 6/6" in result.stderr
    assert "Index of 150: 150/150" in result.stderr


def test_json_is_all_that_is_printed(kitchen: Path) -> None:
    options = ("--frames", 6, "--words", 16, "--index-size", 100, "--json", "--quiet")
    result = slam_bof("bench", "--data", kitchen, *options)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    found = json.loads(result.stdout)
    assert list(found["methods"]) == NAMES
    assert list(found["index"]) == ["100"]
    assert found["frames"] == 6


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    result = slam_bof("bench", "--data", tmp_path / "nowhere")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")
    assert len(result.stderr.splitlines()) == 1
