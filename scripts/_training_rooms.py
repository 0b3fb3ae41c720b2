"""What the included models learn from, or are measured with: real rooms, and synthetic ones.

    DATA/nyu_scenes/labels.csv            single images by room, of NYU Depth v2
    DATA/7scenes/redkitchen/seq-01 ...    sequences, each of one room (SEQUENCES)

Scenes that are none of the classes tell how certain to be. Every real image is described as it is
and as other sensors would have measured it; messy synthetic ones only so, since no sensor has
measured them. Tidy synthetic rooms and flats, as in the demo, are measured by one sensor.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import TypeVar

import numpy as np
from _rendered_views import RenderedViews
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from slam_bof.core import registry
from slam_bof.datasets import read_image_table
from slam_bof.errors import DatasetError
from slam_bof.scenes import (
    UNKNOWN_LABEL,
    FurnitureNetwork,
    LevelledClassifier,
    LevelledFeatures,
    levelled_features,
    remeasure,
    room_network,
)
from slam_bof.synthetic import FIRST_KINDS, ROOM_KINDS
from slam_bof.types import Array, DepthFrame

T = TypeVar("T")
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
MESSY_SEED, TIDY_SEED = 4000, 1000
"""Seeds of the first synthetic rooms."""
REAL, MESSY, TIDY = 0, 1, 2
WEIGHTS = np.array([1.0, 0.3, 0.2])
"""Weight of a real, a messy and a tidy room. A flat counts as a tidy room."""


@dataclass(frozen=True, eq=False)
class Rooms:
    """Features of N views: ``scenes`` (N,) as recorded, ``groups`` (N,), the rooms.

    ``copies`` (N,) has the features by other sensors; ``origins`` (N,) are ``REAL``, ``MESSY`` or
    ``TIDY``, of which flats are too. ``furniture`` is the network that features are from.
    """

    features: list[LevelledFeatures]
    copies: list[list[LevelledFeatures]]
    scenes: list[str]
    groups: list[str]
    origins: NDArray[np.intp]
    furniture: FurnitureNetwork | None = None

    @property
    def is_real(self) -> NDArray[np.bool_]:
        """Whether each view (N,) is of a real room."""
        return self.origins == REAL

    def select(self, kept: NDArray[np.bool_]) -> Rooms:
        """Return some of the views."""
        parts = (self.features, self.copies, self.scenes, self.groups)
        kept_parts = (list(compress(part, kept)) for part in parts)
        return Rooms(*kept_parts, self.origins[kept], self.furniture)

    def labels(self) -> list[str]:
        """Return the class of each view, ``unknown`` where its scene is none."""
        same = [SAME_KIND.get(scene, scene) for scene in self.scenes]
        return [scene if scene in ROOM_KINDS else UNKNOWN_LABEL for scene in same]

    def fit(self, seed: int) -> LevelledClassifier:
        """Train on the views of known scenes; synthetic rooms count less than real ones.

        The more views a room has, the less counts each. Probabilities are calibrated on real
        rooms held out, which count as in training, and on scenes that are no class.
        """
        is_known = np.array(self.labels()) != UNKNOWN_LABEL
        known, unknown = self.select(is_known), self.select(~is_known)
        return LevelledClassifier.fit(
            known.features,
            known.labels(),
            known.groups,
            copies=known.copies,
            weights=known.weights(),
            calibrate_on=known.is_real,
            unknown=unknown.features,
            unknown_weights=unknown.weights(),
            network=room_network(seed),
            furniture=self.furniture,
            seed=seed,
        )

    def weights(self) -> Array:
        """Return the weight of each view (N,)."""
        _, index, counts = np.unique(self.groups, return_inverse=True, return_counts=True)
        return WEIGHTS[self.origins] / np.sqrt(counts[index])


View = tuple[DepthFrame, Array | None, str, str]


def collect(
    data: Path,
    *,
    n_messy: int,
    n_tidy: int,
    n_views: int,
    n_frames: int,
    n_copies: int,
    seed: int,
    rendered: RenderedViews,
    furniture: FurnitureNetwork,
) -> Rooms:
    """Describe all views: ``n_frames`` of each sequence, ``n_views`` of each synthetic room.

    ``n_messy`` and ``n_tidy`` are the numbers of synthetic rooms of each kind.
    """
    parts = (
        real_rooms(data, n_frames, n_copies, seed, furniture),
        messy_rooms(rendered, n_messy, n_views, seed, furniture),
        tidy_rooms(rendered, n_tidy, n_views, furniture),
    )
    return join(parts)


def join(parts: Sequence[Rooms]) -> Rooms:
    """Return the views of all parts."""
    return Rooms(
        [features for part in parts for features in part.features],
        [copies for part in parts for copies in part.copies],
        [scene for part in parts for scene in part.scenes],
        [group for part in parts for group in part.groups],
        np.concatenate([part.origins for part in parts]),
        parts[0].furniture,
    )


def _no_rooms(furniture: FurnitureNetwork | None) -> Rooms:
    return Rooms([], [], [], [], np.zeros(0, np.intp), furniture)


def real_rooms(
    data: Path, n_frames: int, n_copies: int, seed: int, furniture: FurnitureNetwork
) -> Rooms:
    """Describe single images, and ``n_frames`` of each sequence."""
    rng = np.random.default_rng(seed)
    rooms = _no_rooms(furniture)
    views = list(_images(data)) + list(_frames(data, n_frames))
    for frame, down, scene, room in _track(views, "Real rooms"):
        rooms.features.append(levelled_features(frame, gravity_camera=down, furniture=furniture))
        rooms.copies.append([_copy(frame, down, rng, furniture) for _ in range(n_copies)])
        rooms.scenes.append(scene)
        rooms.groups.append(room)
    return replace(rooms, origins=np.full(len(views), REAL))


def messy_rooms(
    rendered: RenderedViews, n_rooms: int, n_views: int, seed: int, furniture: FurnitureNetwork
) -> Rooms:
    """Describe ``n_views`` of each of ``n_rooms`` messy rooms of each kind."""
    rng = np.random.default_rng([seed, MESSY])
    rooms = _no_rooms(furniture)
    for number in _track(range(MESSY_SEED, MESSY_SEED + n_rooms), "Messy rooms"):
        for kind in ROOM_KINDS:
            for frame, down in rendered.messy(kind, number, n_views):
                rooms.features.append(_copy(frame, down, rng, furniture))
                rooms.scenes.append(kind)
                rooms.groups.append(f"{kind} {number}")
    n = len(rooms.features)
    return replace(rooms, copies=[[]] * n, origins=np.full(n, MESSY))


def tidy_rooms(
    rendered: RenderedViews, n_rooms: int, n_views: int, furniture: FurnitureNetwork
) -> Rooms:
    """Describe ``n_views`` of each of ``n_rooms`` tidy rooms of each kind that has some."""
    rooms = _no_rooms(furniture)
    for number in _track(range(TIDY_SEED, TIDY_SEED + n_rooms), "Tidy rooms"):
        for kind in FIRST_KINDS:
            for frame, _ in rendered.tidy(kind, number, n_views):
                rooms.features.append(levelled_features(frame, furniture=furniture))
                rooms.scenes.append(kind)
                rooms.groups.append(f"{kind} {number}")
    n = len(rooms.features)
    return replace(rooms, copies=[[]] * n, origins=np.full(n, TIDY))


def flats(
    rendered: RenderedViews, n_flats: int, n_views: int, furniture: FurnitureNetwork
) -> Rooms:
    """Describe ``n_views`` along the tour of each of ``n_flats`` flats."""
    rooms = _no_rooms(furniture)
    for number in _track(range(TIDY_SEED, TIDY_SEED + n_flats), "Flats"):
        for frame, kind in rendered.tour(number, n_views):
            rooms.features.append(levelled_features(frame, furniture=furniture))
            rooms.scenes.append(kind)
            rooms.groups.append(f"flat {number}")
    n = len(rooms.features)
    return replace(rooms, copies=[[]] * n, origins=np.full(n, TIDY))


def _track(items: Sequence[T], what: str) -> Iterable[T]:
    """Show the progress through items on stderr, beside the figures."""
    return track(items, what, console=Console(stderr=True))


def _copy(
    frame: DepthFrame,
    down: Array | None,
    rng: np.random.Generator,
    furniture: FurnitureNetwork,
) -> LevelledFeatures:
    measured, down = remeasure(frame, rng, down)
    return levelled_features(measured, gravity_camera=down, furniture=furniture)


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
