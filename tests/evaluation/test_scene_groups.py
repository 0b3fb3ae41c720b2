"""Cross-validation by room, and the test of a trained model on scenes known and unknown."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import cv2
import joblib
import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.datasets import LabelledFrame, read_image_table
from slam_bof.errors import DatasetError
from slam_bof.evaluation import (
    cross_validate_groups,
    label_figures,
    split_by_group,
    train_scene_model,
)
from slam_bof.geometry import se3

SIZES_M = {"hall": (0.8, 1.3, 4.0), "store": (2.0, 1.5, 2.0)}


def write_images(folder: Path, n_rooms: int = 5, n_views: int = 3) -> Path:
    """Write views of rooms of two kinds, and the table that lists them."""
    rng = np.random.default_rng(0)
    rows = ["file,scene,group"]
    for label, size in SIZES_M.items():
        for room in range(n_rooms):
            half_m = np.array(size) * rng.uniform(0.9, 1.1, 3)
            for view in range(n_views):
                T = se3.exp(np.array([0, 0.3 * view, 0, 0, 0, 0]))
                name = f"{label}-{room}-{view}.png"
                cv2.imwrite(str(folder / name), box_room_depth_mm(CAMERA, T, tuple(half_m)))
                rows.append(f"{name},{label},{label}-{room}")
    camera = {k: getattr(CAMERA, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "intrinsics.json").write_text(json.dumps(camera))
    (folder / "labels.csv").write_text("\n".join(rows))
    return folder / "labels.csv"


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[LabelledFrame]:
    return read_image_table(write_images(tmp_path_factory.mktemp("rooms")))


def test_rooms_are_trained_with_or_tested_with(frames: list[LabelledFrame]) -> None:
    split = split_by_group(frames)
    sides = [{frame.group for frame in side} for side in (split.train, split.test)]
    assert not sides[0] & sides[1]
    assert len(sides[1]) == 2
    assert {frame.label for frame in split.test} == set(SIZES_M)


def test_methods_are_tested_on_rooms_never_seen(frames: list[LabelledFrame]) -> None:
    done: list[tuple[str, int, int]] = []
    results = cross_validate_groups(
        frames,
        ["ours", "tokens", "bag:linear"],
        n_folds=2,
        n_repeats=2,
        n_copies=1,
        n_words=8,
        on_progress=lambda *said: done.append(said),
    )
    assert [result.method for result in results] == ["ours", "tokens", "bag:linear"]
    for result in results:
        assert result.true == tuple(frame.label for frame in frames) * 2
        np.testing.assert_allclose(result.probabilities.sum(axis=1), 1.0)
        assert min(result.label_ms, result.n_bytes) > 0
    assert results[0].scores.accuracy > 0.9
    assert done[-1] == ("Testing", 4, 4)


def test_methods_evaluated_two_at_a_time_give_the_same(frames: list[LabelledFrame]) -> None:
    names = ["bag:linear", "bag:rbf"]
    evaluate = partial(
        cross_validate_groups, frames, names, n_folds=2, n_repeats=1, n_copies=1, n_words=8
    )
    with joblib.parallel_config(backend="threading"):  # processes are in test_scene_benchmark
        one, two = evaluate(n_jobs=1), evaluate(n_jobs=2)
    assert [result.method for result in two] == names
    for ours, theirs in zip(one, two, strict=True):
        np.testing.assert_array_equal(ours.probabilities, theirs.probabilities)


def test_labels_that_say_nothing_about_new_rooms_are_no_better_than_chance(
    frames: list[LabelledFrame],
) -> None:
    """Were a room on both sides of a fold, its views would tell its label, whatever that is."""
    dealt = [
        LabelledFrame(f.dataset, f.index, "ab"[int((f.group or "0")[-1]) % 2], f.group)
        for f in frames
    ]
    (result,) = cross_validate_groups(
        dealt, ["ours"], n_folds=5, n_repeats=1, n_copies=0, n_words=8
    )
    assert result.scores.accuracy < 0.75


def test_training_keeps_rooms_to_test_with(frames: list[LabelledFrame]) -> None:
    trained = train_scene_model(frames, trained_on="boxes", n_words=8, n_copies=1)
    assert trained.n_checked == 6
    assert trained.scores is not None
    assert trained.scores.accuracy > 0.8
    assert trained.model.levelled_classifier is not None


def test_what_cannot_be_divided_is_refused(frames: list[LabelledFrame]) -> None:
    with pytest.raises(DatasetError, match="found 1 classes in 5 groups, expected at least two"):
        cross_validate_groups(frames[:15], ["ours"])
    with pytest.raises(DatasetError, match="method 'magic': found none, expected some of ours"):
        cross_validate_groups(frames, ["magic"])


def test_unknown_is_right_for_a_scene_that_is_no_class() -> None:
    probabilities = np.array([[0.9, 0.1], [0.3, 0.7], [0.35, 0.35], [0.8, 0.2]])
    figures = label_figures(probabilities, ["hall", "store"], ["hall", "hall", "cave", "cave"])
    assert figures["accuracy"] == 0.5
    assert figures["answered"] == 0.75
    assert figures["right"] == 0.5
    assert figures["wrong_and_sure"] == 0.5
    assert figures["unknown_auroc"] == 0.75
    assert [row["unknown"] for row in figures["by_class"]] == [0.5, 0.0]
    assert label_figures(probabilities, ["hall", "store"], ["cave"] * 4)["accuracy"] is None
