import numpy as np
import pytest

from slam_bof.bof import ContourParams, LayerParams, PlaceParams, descriptors
from slam_bof.geometry import PointParams
from slam_bof.scenes import (
    FrameDescriptors,
    LevelledFeatures,
    TrainingFrame,
    describe_frames,
    fit_model,
    train_model,
)
from slam_bof.scenes.height_profile import N_PROFILE_VALUES
from slam_bof.scenes.shape_words import N_SHAPE_VALUES
from slam_bof.types import DepthFrame, Intrinsics

CAMERA = Intrinsics(width=40, height=30, fx=35.0, fy=35.0, cx=19.5, cy=14.5)
PARAMS = PlaceParams(
    points=PointParams(stride=1),
    layers=LayerParams(n_layers=3, resolution_px=30),
    contours=ContourParams(closing_px=3),
)


def frame(kind, seed):
    """Return a wall with a box before it, or a cross."""
    rng = np.random.default_rng(seed)
    depth = np.full((30, 40), 3000.0)
    row, column = rng.integers(2, 8), rng.integers(2, 8)
    height, width = rng.integers(15, 21, 2)
    upright = (slice(row, row + height), slice(column + width // 3, column + 2 * width // 3))
    across = (slice(row + height // 3, row + 2 * height // 3), slice(column, column + width))
    box = [(slice(row, row + height), slice(column, column + width))]
    for part in {"box": box, "cross": [upright, across]}[kind]:
        depth[part] = 1500
    depth += rng.normal(0, 5, depth.shape)
    return DepthFrame(0.0, depth.astype(np.uint16), CAMERA)


def frames(first=0, n=40):
    for seed in range(first, first + n):
        kind = ("box", "cross")[seed % 2]
        yield TrainingFrame(frame(kind, seed), kind, f"room-{seed // 4}")


def test_a_model_labels_unseen_frames():
    model = train_model(frames(), PARAMS, n_words=12, trained_on="boxes")
    describer = model.describer()
    right = [
        model.bag_classifier.predict_bag(describer.describe(item.frame)).label == item.label
        for item in frames(first=100)
    ]
    assert np.mean(right) > 0.9
    assert model.trained_on == "boxes"


def test_models_are_of_height_profiles_alone():
    described = describe_frames(frames(n=20), PARAMS, levelled=True)
    assert all(len(item.shapes) == 0 for item in described.levelled)
    model = fit_model(described, PARAMS, n_words=12, trained_on="boxes")
    assert model.levelled_classifier.vocabulary is None


def test_a_bag_at_hand_spares_the_labeller_describing_the_frame():
    model = train_model(frames(), PARAMS, n_words=12, trained_on="boxes", levelled=False)
    box, cross = (item.frame for item in frames(first=100, n=2))
    labeller = model.labeller()
    asked = labeller.label(box)
    assert asked.label == "box"
    given = labeller.label(cross, bag=model.describer().describe(box))
    np.testing.assert_array_equal(given.probabilities, asked.probabilities)


def test_frames_are_described_in_order_and_reported():
    seen = []
    described = describe_frames(frames(n=5), PARAMS, on_frame=seen.append)
    assert seen == [1, 2, 3, 4, 5]
    each = [descriptors(item.frame, PARAMS) for item in frames(n=5)]
    assert described.counts.tolist() == [len(values) for values in each]
    np.testing.assert_array_equal(described.values, np.concatenate(each))
    assert described.labels == ("box", "cross", "box", "cross", "box")
    assert described.groups == ("room-0",) * 4 + ("room-1",)


def test_frames_described_two_at_a_time_are_the_same():
    one, two = (
        describe_frames(frames(n=5), PARAMS, levelled=True, n_copies=1, n_jobs=n) for n in (1, 2)
    )
    np.testing.assert_array_equal(one.values, two.values)
    assert (one.labels, one.groups) == (two.labels, two.groups)
    for of_one, of_two in zip(one.levelled, two.levelled, strict=True):
        np.testing.assert_array_equal(of_one.profile, of_two.profile)
        np.testing.assert_array_equal(of_one.shapes, of_two.shapes)
    for (of_one,), (of_two,) in zip(one.copies, two.copies, strict=True):
        np.testing.assert_array_equal(of_one.profile, of_two.profile)
    assert one.copies[0][0].profile.tobytes() != one.levelled[0].profile.tobytes()


def test_of_some_frames_all_is_kept():
    described = describe_frames(frames(n=6), PARAMS, levelled=True)
    some = described.select([4, 1])
    each = described.by_frame()
    np.testing.assert_array_equal(some.values, np.concatenate([each[4], each[1]]))
    assert some.counts.tolist() == [len(each[4]), len(each[1])]
    assert (some.labels, some.groups) == (("box", "cross"), ("room-1", "room-0"))
    assert some.levelled == (described.levelled[4], described.levelled[1])


def test_the_same_seed_gives_the_same_model():
    first, again, other = (
        train_model(frames(n=20), PARAMS, n_words=12, seed=seed, trained_on="boxes").content_hash
        for seed in (1, 1, 2)
    )
    assert first == again != other


def test_frames_without_labels_teach_words_only():
    unlabelled = [TrainingFrame(item.frame) for item in frames()]
    alone = train_model(unlabelled, PARAMS, n_words=12, trained_on="boxes")
    assert alone.bag_classifier is None
    both = train_model([*unlabelled, *frames(first=40)], PARAMS, n_words=12, trained_on="boxes")
    assert both.bag_classifier.classes_.tolist() == ["box", "cross"]


def test_too_few_frames_are_refused():
    with pytest.raises(ValueError, match="n_words must be at most the number of descriptors"):
        train_model(frames(n=2), PARAMS, trained_on="boxes")
    with pytest.raises(ValueError, match=r"minimum of 1 is required|n_words"):
        train_model([], PARAMS, trained_on="nothing")


def test_without_groups_confidence_is_learnt_on_stretches_of_time():
    """Neighbours are alike, but what a class looks like changes from stretch to stretch."""

    def sweep(seed: int, n: int = 60) -> list[LevelledFeatures]:
        rng = np.random.default_rng(seed)
        places = np.repeat(rng.standard_normal((n // 12, N_PROFILE_VALUES)), 12, axis=0)
        places[:, 0] += seed % 2
        profiles = (places + 0.02 * rng.standard_normal(places.shape)).astype(np.float32)
        return [
            LevelledFeatures(profile, np.zeros((1, N_SHAPE_VALUES), np.float32))
            for profile in profiles
        ]

    values = np.random.default_rng(0).random((240, PARAMS.bof.n_values), np.float32)
    labels, none, counts = ("bath",) * 60 + ("hall",) * 60, ("",) * 120, np.full(120, 2)
    described = FrameDescriptors(values, counts, labels, none, (*sweep(0), *sweep(1)))
    levels = fit_model(described, PARAMS, n_words=4, trained_on="sweeps").levelled_classifier
    fresh = [levels.label_features(v) for seed in range(2, 12) for v in sweep(seed)[::12]]
    right = np.mean([s.label == ("bath", "hall")[k // 5 % 2] for k, s in enumerate(fresh)])
    assert np.mean([scene.probability for scene in fresh]) < right + 0.15
