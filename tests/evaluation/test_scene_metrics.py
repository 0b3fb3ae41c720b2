from __future__ import annotations

import numpy as np
import pytest

from slam_bof.evaluation import calibration_error, reliability, roc
from slam_bof.evaluation.scene_metrics import scene_scores

CLASSES = ("bath", "hall", "office")


def test_accuracy_of_frames_and_of_classes() -> None:
    true = ["bath"] * 8 + ["hall"] * 2
    p = np.array([[0.8, 0.1, 0.1]] * 8 + [[0.6, 0.3, 0.1], [0.1, 0.8, 0.1]])
    scores = scene_scores(p, true, CLASSES)
    assert scores.accuracy == 0.9
    assert scores.mean_class_accuracy == 0.75
    bath, hall, office = scores.by_class
    assert (bath.n_frames, bath.precision, bath.recall) == (8, 8 / 9, 1.0)
    assert hall.f1 == pytest.approx(2 / 3)
    assert (office.precision, office.recall, office.f1) == (None, None, None)
    assert scores.confusion.tolist() == [[8, 0, 0], [1, 1, 0], [0, 0, 0]]
    with pytest.raises(ValueError, match="at least one label"):
        scene_scores(np.empty((0, 3)), [], CLASSES)


def test_labels_as_often_right_as_they_say_are_calibrated() -> None:
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0.3, 1.0, 20_000)
    honest = rng.random(20_000) < confidence
    assert calibration_error(confidence, honest) < 0.02
    assert calibration_error(np.full(10, 0.9), np.zeros(10, bool)) == pytest.approx(0.9)
    assert calibration_error(np.ones(10), np.ones(10, bool)) == 0.0
    means, shares, counts = reliability(np.array([0.5, 0.95]), np.array([True, False]))
    assert (means.tolist(), shares.tolist(), counts.tolist()) == ([0.5, 0.95], [1, 0], [1, 1])


def test_curves_of_each_class_against_the_others() -> None:
    p = np.array([[0.9, 0.1, 0], [0.4, 0.6, 0], [0.6, 0.4, 0], [0.2, 0.8, 0]])
    bath, hall = roc(p, ["bath", "bath", "hall", "hall"], CLASSES)
    assert (bath.label, hall.label) == ("bath", "hall")
    assert bath.auc == hall.auc == 0.75
    assert bath.false_positive[0] == 0.0
    assert bath.true_positive[-1] == 1.0
