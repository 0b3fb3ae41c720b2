"""Protocols and methods on small rooms: who is judged on what, and that they learn at all."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import CAMERA
from labelled_boxes import SIZES_M, write_box

from slam_bof.datasets import LabelledFrame, frames_of, open_labelled
from slam_bof.errors import DatasetError
from slam_bof.evaluation import (
    Split,
    compare_methods,
    compare_named_methods,
    make_methods,
    split_at_random,
    split_officially,
    split_rooms,
    split_sunrgbd,
)
from slam_bof.evaluation.scene_methods import DescriptorMethod, ModelMethod
from slam_bof.geometry import se3
from slam_bof.scenes import model as models
from slam_bof.types import DepthFrame
from slam_bof.visualization import write_comparison


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three scenes of two sequences each, with split files."""
    root = tmp_path_factory.mktemp("boxes")
    for label in SIZES_M:
        write_box(root / label / "seq-01", label)
        write_box(root / label / "seq-02", label, turned=0.1)
        (root / label / "TrainSplit.txt").write_text("sequence1\n")
        (root / label / "TestSplit.txt").write_text("sequence2\n")
    return root


def test_official_split(scenes: Path) -> None:
    split = split_officially([(label, scenes / label) for label in SIZES_M], every=3)
    assert {f.dataset.sequence for f in split.train} == {f"{label}/seq-01" for label in SIZES_M}
    assert {f.dataset.sequence for f in split.test} == {f"{label}/seq-02" for label in SIZES_M}
    assert len(split.train) == len(split.test) == 3 * 4


def test_methods_learn_the_same_and_are_judged_on_the_same(scenes: Path, tmp_path: Path) -> None:
    split = split_officially([(label, scenes / label) for label in SIZES_M])
    methods = make_methods(["thumbnail", "bof", "sift", "gist-depth+thumbnail"], n_words=8)
    methods.insert(1, ModelMethod(n_words=8, levelled=False))
    seen: list[tuple[str, int, int]] = []
    results, left_out = compare_methods(split, methods, on_progress=lambda *said: seen.append(said))
    assert list(left_out) == ["sift"]
    assert left_out["sift"].startswith("no colour images in hall/seq-01")
    assert [r.method for r in results] == ["thumbnail", "ours", "bof", "gist-depth+thumbnail"]
    for result in results:
        assert result.probabilities.shape == (36, 3)
        np.testing.assert_allclose(result.probabilities.sum(axis=1), 1.0)
        assert result.scores.classes == tuple(SIZES_M)
        assert result.label_ms > 0
        assert result.n_bytes > 0
    assert results[0].scores.accuracy > 0.9
    assert {what for what, *_ in seen} == {"Describing", "Training", "Testing"}
    assert ("Describing", 36, 36) in seen

    page, *pictures = write_comparison(tmp_path, results, left_out, title="Boxes", subtitle="few")
    text = page.read_text(encoding="utf-8")
    assert "sift is left out: no colour images" in text
    assert [p.name for p in pictures] == [
        "confusion_thumbnail.png", "confusion_ours.png", "confusion_bof.png",
        "confusion_gist-depth_thumbnail.png",
    ]  # fmt: skip
    assert all(cv2.imread(str(picture)) is not None for picture in pictures)


def test_methods_evaluated_two_at_a_time_give_the_same(scenes: Path) -> None:
    split = split_officially([(label, scenes / label) for label in SIZES_M], every=3)
    one, two = (
        compare_named_methods(split, ["thumbnail", "sift", "bof"], n_words=8, n_jobs=n)
        for n in (1, 2)
    )
    assert one[1] == two[1]
    assert [result.method for result in two[0]] == ["thumbnail", "bof"]
    for ours, theirs in zip(one[0], two[0], strict=True):
        np.testing.assert_array_equal(ours.probabilities, theirs.probabilities)
        assert (ours.true, ours.n_bytes) == (theirs.true, theirs.n_bytes)
        assert theirs.train_s > 0.0


def test_a_grid_search_chooses_on_the_training_frames_alone(scenes: Path) -> None:
    split = split_officially([(label, scenes / label) for label in SIZES_M], every=2)
    (result,), left_out = compare_methods(split, make_methods(["bof:grid"], n_words=8))
    assert not left_out
    chosen = result.svm_params
    assert chosen is not None
    assert str(chosen).startswith(f"{chosen.name}, C {chosen.C:g}")
    # The same split with other test frames leads to the same choice.
    other = Split(split.train, split.test[::5] + split.train[::7])
    (again,), _ = compare_methods(other, make_methods(["bof:grid"], n_words=8))
    assert again.svm_params == chosen
    with pytest.raises(DatasetError, match="grid search is for bags of words, got thumbnail:grid"):
        make_methods(["thumbnail:grid"])


def test_a_class_that_was_never_trained_with_counts_as_wrong(scenes: Path) -> None:
    frames = [f for label in SIZES_M for f in frames_of(open_labelled(label, scenes / label))]
    known = [f for f in frames if f.label != "store"]
    split = Split(known[::2], [f for f in frames if f.label == "store"] + known[1::2])
    (result,), _ = compare_methods(split, make_methods(["thumbnail"]))
    store = result.scores.classes.index("store")
    assert (result.probabilities[:, store] == 0).all()
    assert result.scores.by_class[store].recall == 0.0


def test_what_finds_too_little_is_left_out(scenes: Path) -> None:
    hall = frames_of(open_labelled("hall", scenes / "hall"))[:6]
    wall = Wall()
    split = split_at_random(hall + [LabelledFrame(wall, k, "wall") for k in range(6)])
    results, left_out = compare_methods(split, make_methods(["bof", "thumbnail"]))
    assert [r.method for r in results] == ["bof", "thumbnail"]
    assert left_out == {}
    nothing = split_at_random([LabelledFrame(wall, k, "ab"[k % 2]) for k in range(12)])
    results, left_out = compare_methods(nothing, make_methods(["bof"]))
    assert results == []
    assert "found 0 descriptors of bof" in left_out["bof"]


class Wall:
    """A data set of nothing to be seen."""

    sequence = "wall"

    def frame(self, index: int) -> DepthFrame:
        return DepthFrame(index / 30, np.zeros((120, 160), np.uint16), CAMERA)

    def gray(self, index: int) -> None:
        return None


def test_bags_stand_alone() -> None:
    with pytest.raises(DatasetError, match="'bof\\+gist-depth': bags of words cannot be put"):
        make_methods(["bof+gist-depth"])
    assert DescriptorMethod(["gist", "thumbnail"]).needs_gray


def test_rooms_to_test_with_are_never_those_to_train_with() -> None:
    split = split_rooms(3, 2, 4, seed=1)
    assert len(split.train) == 9 * 3 * 4
    assert len(split.test) == 9 * 2 * 4
    rooms = [{f.dataset.sequence for f in side} for side in (split.train, split.test)]
    assert not rooms[0] & rooms[1]
    assert {f.label for f in split.test} == {f.label for f in split.train}
    other = split_rooms(3, 2, 4, seed=2)
    assert not {f.dataset.sequence for f in other.train} & rooms[0]
    with pytest.raises(DatasetError, match="expected at most 4000 in all"):
        split_rooms(3000, 2, 4, seed=1)


def test_views_of_a_room_come_with_their_shading() -> None:
    frame = split_rooms(2, 1, 2).train[0]
    depth, gray = frame.read(gray=True)
    assert depth.depth.shape == gray.shape == (480, 640)
    assert gray.std() > 10
    again, _ = frame.read(gray=False)
    np.testing.assert_array_equal(again.depth, depth.depth)


def test_sunrgbd_needs_a_data_set_that_says_what_trains(scenes: Path) -> None:
    with pytest.raises(DatasetError, match="found 7scenes, expected a data set that says"):
        split_sunrgbd(scenes / "hall" / "seq-01")


def test_a_given_model_labels_as_it_is(look, standpoint):
    """A method built from a model needs no training."""
    model = models.resolve("default")
    T = se3.pose(
        np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [*standpoint, 1.3]
    )
    frame = look(T, 0)
    probabilities = ModelMethod(model=model).probabilities(frame, None)
    scene = model.labeller().label(frame)
    assert probabilities.sum() == pytest.approx(1.0)
    assert probabilities.max() == pytest.approx(scene.probability)
    with pytest.raises(RuntimeError, match="fitted first"):
        ModelMethod().probabilities(frame, None)
