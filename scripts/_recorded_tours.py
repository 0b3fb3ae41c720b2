"""Labels of keyframes along recorded sequences, by models that have not learnt them.

The path of a sequence does not depend on what labels it, if no loop is rejected for its labels.
Each sequence is therefore run once, and its keyframes are then labelled by one model after another,
as ``LoopCloser`` does: each alone, live by the filter, and smoothed over the whole map.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import registry
from slam_bof.evaluation import MAX_DOUBTFUL, calibration_error
from slam_bof.scenes import (
    FurnitureNetwork,
    LevelledClassifier,
    LevelledFeatures,
    SceneFilter,
    SceneFilterParams,
    label_map,
    levelled_features,
)
from slam_bof.slam import Config, LoopCloser, MiniSlam, config as configs
from slam_bof.types import Array, Keyframe, Scene

__all__ = [
    "CALIBRATION_COLUMNS",
    "TOUR_COLUMNS",
    "RecordedTour",
    "calibration_row",
    "labels_row",
    "record_tour",
    "tour_config",
]

Labels = tuple[list[Scene], list[Scene], list[Scene]]
"""The labels of keyframes alone, live and smoothed."""
TOUR_COLUMNS = {
    "name": "sequence", "label": "scene", "n_keyframes": "keyf", "alone": "alone right",
    "alone_confidence": "its prob.", "smoothed": "smoothed labels", "right": "best right",
    "confidence": "its prob.", "max_confidence": "largest", "n_wrong_and_sure": "wrong and sure",
}  # fmt: skip
CALIBRATION_COLUMNS = {
    "name": "sequences", "n_keyframes": "keyf", "alone_ece": "ECE alone", "live_ece": "live",
    "smoothed_ece": "smoothed",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class RecordedTour:
    """The K keyframes of a run, their features, and their poses in the map (K, 4, 4)."""

    keyframes: list[Keyframe]
    features: list[LevelledFeatures]
    T_map_camera: Array
    components: NDArray[np.intp]

    def label(self, classifier: LevelledClassifier, params: SceneFilterParams) -> Labels:
        """Return the labels of the keyframes alone, live and smoothed."""
        online = SceneFilter(params)
        alone, live = [], []
        for keyframe, features in zip(self.keyframes, self.features, strict=True):
            scene = classifier.label_features(features)
            alone.append(scene)
            live.append(
                online.update(
                    scene,
                    keyframe.stamp_s,
                    keyframe.T_odom_camera[:3, 3],
                    axis=keyframe.T_odom_camera[:3, 2],
                    segment=keyframe.segment,
                )
            )
        labelled = [replace(k, scene=s) for k, s in zip(self.keyframes, alone, strict=True)]
        smoothed, _ = label_map(labelled, self.T_map_camera, params, components=self.components)
        return alone, live, [scene for scene in smoothed if scene is not None]


def tour_config() -> Config:
    """Return the preset ``indoor``, without the check of loops by labels."""
    return configs.override(configs.preset("indoor"), ["loops.min_scene_agreement=0"])


def record_tour(
    path: Path, config: Config, furniture: FurnitureNetwork | None = None
) -> RecordedTour:
    """Run a sequence, and describe its keyframes as the run does, with a model's furniture."""
    dataset = registry.open_dataset(path)
    closer = LoopCloser.from_config(config)
    odometry = registry.build("odometry", config.odometry.name, config.odometry.options)
    result = MiniSlam(odometry, closer).run(dataset)
    keyframes = list(closer.map.keyframes)
    features = []
    for keyframe in keyframes:
        frame = dataset.frame(int(result.indices[keyframe.frame_index])).corrected(config.sensor)
        gravity_camera = keyframe.T_odom_camera[:3, :3].T @ np.array(config.gravity_odom)
        features.append(
            levelled_features(frame, gravity_camera=gravity_camera, furniture=furniture)
        )
    return RecordedTour(keyframes, features, closer.map.poses(), closer.map.components)


def labels_row(name: str, truth: str, tour: RecordedTour, labels: Labels) -> dict[str, Any]:
    """Return the figures of one sequence, all of which shows ``truth``."""
    alone, live, smoothed = labels
    counts = Counter(scene.label for scene in smoothed).most_common()
    confidence, right = _confidence(smoothed, truth)
    wrong = [s.probability > MAX_DOUBTFUL and s.label != truth for s in (*live, *smoothed)]
    return {
        "name": name,
        "label": truth,
        "n_keyframes": len(tour.keyframes),
        "alone": float(_confidence(alone, truth)[1].mean()),
        "alone_confidence": float(_confidence(alone, truth)[0].mean()),
        "smoothed": ", ".join(f"{label} {n}" for label, n in counts),
        "confidence": float(confidence.mean()),
        "max_confidence": float(confidence.max()),
        "right": float(right.mean()),
        "n_wrong_and_sure": int(np.sum(wrong)),
    }


def calibration_row(name: str, labelled: Sequence[tuple[str, Labels]]) -> dict[str, Any]:
    """Return the calibration errors over sequences, of which ``labelled`` has truth and labels.

    The most probable class counts as the label, ``unknown`` or not; of a sequence that shows no
    class it is wrong.
    """
    row: dict[str, Any] = {"name": name, "n_keyframes": sum(len(s[0]) for _, s in labelled)}
    for k, key in enumerate(("alone_ece", "live_ece", "smoothed_ece")):
        pairs = [_confidence(scenes[k], truth) for truth, scenes in labelled]
        confidence, right = (np.concatenate(values) for values in zip(*pairs, strict=True))
        row[key] = calibration_error(confidence, right)
    return row


def _confidence(scenes: Sequence[Scene], truth: str) -> tuple[Array, NDArray[np.bool_]]:
    best = [scene.classes[int(scene.probabilities.argmax())] for scene in scenes]
    return np.array([scene.probabilities.max() for scene in scenes]), np.array(best) == truth
