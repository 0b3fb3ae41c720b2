"""What the default model learns from, or is measured with: real rooms, and messy synthetic ones.

    DATA/nyu_scenes/labels.csv            single images by room, of NYU Depth v2
    DATA/7scenes/redkitchen/seq-01 ...    sequences, each of one room (SEQUENCES)

Scenes that are none of the classes are for measuring only. Every image is described as it is and
as other sensors would have measured it; synthetic ones only so, since no sensor has measured them.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from slam_bof.core import registry
from slam_bof.datasets import read_image_table
from slam_bof.errors import DatasetError
from slam_bof.scenes import (
    UNKNOWN_LABEL,
    LevelledClassifier,
    LevelledFeatures,
    levelled_features,
    remeasure,
    room_network,
)
from slam_bof.synthetic import ROOM_KINDS, messy_views
from slam_bof.types import Array, DepthFrame

NYU_CAMERA = {
    "width": 640, "height": 480, "fx": 518.86, "fy": 519.47, "cx": 325.58, "cy": 253.74,
    "depth_scale": 1 / 0.039198, "depth_offset": 0.5,
}  # fmt: skip
SAME_KIND = {
    "home_office": "office",
    "study": "office",
    "study_room": "office",
    "computer_lab": "office",
    "office_kitchen": "kitchen",
}
"""Scenes of NYU Depth v2 that are of one of the classes; others that are none are unknown."""
SEQUENCES = {
    "7scenes/redkitchen/seq-01": "kitchen",
    "realsense/lab/seq-01": UNKNOWN_LABEL,
    "realsense/office/seq-01": "office",
    "icsl_corridor": "corridor",
    "iphone_meeting": "meeting_room",
    "cafe": UNKNOWN_LABEL,
    "7scenes/stairs/seq-01": UNKNOWN_LABEL,
}
FIRST_SEED = 4000
SYNTHETIC_WEIGHT = 0.3
"""Weight of a synthetic room against a real one."""


@dataclass(frozen=True, eq=False)
class Rooms:
    """Features of N views: ``scenes`` (N,) as recorded, ``groups`` (N,), the rooms.

    ``copies`` (N,) has the features by other sensors; ``is_real`` (N,) says which are no synthetic
    rooms.
    """

    features: list[LevelledFeatures]
    copies: list[list[LevelledFeatures]]
    scenes: list[str]
    groups: list[str]
    is_real: NDArray[np.bool_]

    def select(self, kept: NDArray[np.bool_]) -> Rooms:
        """Return some of the views."""
        parts = (self.features, self.copies, self.scenes, self.groups)
        return Rooms(*(list(compress(part, kept)) for part in parts), self.is_real[kept])

    def labels(self) -> list[str]:
        """Return the class of each view, ``unknown`` where its scene is none."""
        same = [SAME_KIND.get(scene, scene) for scene in self.scenes]
        return [scene if scene in ROOM_KINDS else UNKNOWN_LABEL for scene in same]

    def fit(self, seed: int) -> LevelledClassifier:
        """Train on the views of known scenes; synthetic rooms count less than real ones.

        The more views a room has, the less counts each. Probabilities are calibrated on real
        rooms held out.
        """
        known = self.select(np.array(self.labels()) != UNKNOWN_LABEL)
        _, index, counts = np.unique(known.groups, return_inverse=True, return_counts=True)
        weights = np.where(known.is_real, 1.0, SYNTHETIC_WEIGHT) / np.sqrt(counts[index])
        return LevelledClassifier.fit(
            known.features,
            known.labels(),
            known.groups,
            copies=known.copies,
            weights=weights,
            calibrate_on=known.is_real,
            network=room_network(seed),
            seed=seed,
        )


View = tuple[DepthFrame, Array | None, str, str]


def collect(
    data: Path, *, n_synthetic: int, n_views: int, n_frames: int, n_copies: int, seed: int
) -> Rooms:
    """Describe all views: ``n_frames`` of each sequence, ``n_views`` of each synthetic room."""
    rng = np.random.default_rng(seed)
    rooms = Rooms([], [], [], [], np.zeros(0, bool))
    real = list(_images(data)) + list(_frames(data, n_frames))
    for frame, down, scene, room in track(real, "Real rooms"):
        rooms.features.append(levelled_features(frame, gravity_camera=down))
        rooms.copies.append([_copy(frame, down, rng) for _ in range(n_copies)])
        rooms.scenes.append(scene)
        rooms.groups.append(room)
    for number in track(range(FIRST_SEED, FIRST_SEED + n_synthetic), "Synthetic rooms"):
        for kind in ROOM_KINDS:
            for frame, down in messy_views(kind, number, n_views):
                rooms.features.append(_copy(frame, down, rng))
                rooms.copies.append([])
                rooms.scenes.append(kind)
                rooms.groups.append(f"{kind} {number}")
    is_real = np.arange(len(rooms.features)) < len(real)
    return Rooms(rooms.features, rooms.copies, rooms.scenes, rooms.groups, is_real)


def _copy(frame: DepthFrame, down: Array | None, rng: np.random.Generator) -> LevelledFeatures:
    measured, down = remeasure(frame, rng, down)
    return levelled_features(measured, gravity_camera=down)


def _images(data: Path) -> Iterator[View]:
    with tempfile.TemporaryDirectory() as folder:
        camera = Path(folder) / "camera.json"
        camera.write_text(json.dumps(NYU_CAMERA))
        for item in read_image_table(data / "nyu_scenes" / "labels.csv", camera_file=camera):
            down = None if item.gravity_camera is None else np.array(item.gravity_camera)
            yield item.read(gray=False)[0], down, item.label, f"nyu {item.group}"


def _frames(data: Path, n: int, names: Sequence[str] = tuple(SEQUENCES)) -> Iterator[View]:
    """Yield ``n`` frames of each sequence, evenly spread."""
    for name in names:
        if not (data / name).is_dir():
            raise DatasetError(f"{data}: found no {name}, expected the sequence")
        dataset = registry.open_dataset(data / name)
        chosen = np.linspace(0, len(dataset) - 1, min(n, len(dataset))).round()
        for index in chosen.astype(int).tolist():
            yield dataset.frame(index), None, SEQUENCES.get(name, name), name
