"""The script that measures the default model, on a few frames and made-up features."""

import numpy as np
import pytest

from slam_bof.scenes import LevelledFeatures, SceneFilterParams, model as models
from slam_bof.scenes.height_profile import N_PROFILE_VALUES
from slam_bof.scenes.shape_words import N_SHAPE_VALUES
from slam_bof.slam import config
from slam_bof.types import Scene

FIVE = ("bathroom", "bedroom", "kitchen", "living_room", "office")


@pytest.fixture(scope="module")
def script(load_script):
    return load_script("measure_default_model")


def test_keyframes_are_labelled_as_the_run_labels_them(script, write_turn, tmp_path):
    folder = tmp_path / "room" / "seq-01"
    write_turn(folder, [0.0, 0.1, 0.2, 0.3, 0.4])
    chosen = config.override(
        script["tour_config"](), ["keyframes.policy=every", "keyframes.every=1"]
    )
    classifier = models.resolve("default").levelled_classifier
    tour = script["record_tour"](folder, chosen, classifier.furniture)
    assert len(tour.keyframes) == 5
    alone, live, smoothed = tour.label(classifier, chosen.labels)
    for keyframe, by_itself, online in zip(tour.keyframes, alone, live, strict=True):
        # Labelled together, a view's last digits may differ from those of one labelled by itself.
        for again, before in ((by_itself, keyframe.scene), (online, keyframe.smoothed)):
            np.testing.assert_allclose(again.probabilities, before.probabilities, rtol=1e-4)
    assert len(smoothed) == 5
    row = script["labels_row"]("turn", "kitchen", tour, (alone, live, smoothed))
    assert set(row) == set(script["TOUR_COLUMNS"])
    assert row["confidence"] == pytest.approx(np.mean([s.probability for s in smoothed]))


def test_the_calibration_error_counts_unknown_labels_as_the_most_probable_class(script):
    p = np.array([0.3, 0.7])
    sure, unsure = (Scene(label, 0.7, ("bath", "kitchen"), p) for label in ("kitchen", "unknown"))
    labels = [sure, unsure]
    right = ("kitchen", (labels, labels, labels))
    row = script["calibration_row"]("all", [right])
    assert row["n_keyframes"] == 2
    assert row["smoothed_ece"] == pytest.approx(0.3)
    row = script["calibration_row"]("all", [right, ("unknown", (labels, labels, labels))])
    assert row["smoothed_ece"] == pytest.approx(0.2), "right for half of the keyframes"


def views(seed):
    """Rooms of five kinds, whose profiles tell the kind; five rooms of each, three views a room."""
    rng = np.random.default_rng(seed)
    scenes = np.repeat(FIVE, 15)
    groups = [f"nyu {scene} {k // 3}" for k, scene in enumerate(scenes)]
    profiles = rng.normal(size=(75, N_PROFILE_VALUES)).astype(np.float32)
    for kind in range(5):
        profiles[15 * kind : 15 * kind + 15, 30 * kind : 30 * kind + 30] += 2.0
    none = np.empty((0, N_SHAPE_VALUES), np.float32)
    return [LevelledFeatures(profile, none) for profile in profiles], scenes.tolist(), groups


def test_rooms_are_labelled_by_models_without_them(script, monkeypatch):
    features, scenes, groups = views(0)
    rooms = script["Rooms"](features, [[]] * 75, scenes, groups, np.zeros(75, np.intp))
    monkeypatch.setitem(script["score"].__globals__, "SEQUENCES", {})
    p, learnt = script["cross_validate"](rooms, 5, 0, 0.5)
    assert p.sum(axis=1) == pytest.approx(np.ones(75))
    assert len(learnt) == 5 * 10, "half of the 20 rooms outside each fold"
    rows = script["score"](rooms, p)
    assert rows[0]["label"] == "all"
    assert rows[0]["accuracy"] > 0.9
    monkeypatch.setitem(script["score"].__globals__, "SEQUENCES", {groups[0]: "unknown"})
    assert script["score"](rooms, p)[-1]["accuracy"] is None, "of a scene that is no class"
    (first, *_) = script["summarise"]([rows, rows], learnt + learnt, 10)
    assert first["n_rooms"] == 10
    assert first["accuracy"] == rows[0]["accuracy"]
    assert first["accuracy_sd"] == 0.0
    by_class = [row for row in rows if row["name"] == "NYU, five kinds"][1:]
    assert np.mean([row["accuracy"] for row in by_class]) == pytest.approx(
        rows[0]["mean_class_accuracy"]
    )


def test_smoothing_takes_the_defaults_of_a_run(script):
    assert script["tour_config"]().labels == SceneFilterParams()
