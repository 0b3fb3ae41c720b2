"""What the furniture network of the included models learns from: synthetic rooms of their own.

No other synthetic room that models learn from, or are measured with, has one of these seeds, so
that what the network sees in those is what it sees in rooms that are new to it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.progress import track

from slam_bof.scenes import (
    FurnitureNetwork,
    FurnitureTraining,
    FurnitureView,
    fit_furniture,
    furniture_view,
    remeasure_labelled,
)
from slam_bof.synthetic import PIECES, ROOM_KINDS, furnished_views

__all__ = ["learn_furniture"]

FIRST_SEED = 6000
TIDY_EVERY = 3
"""One of so many rooms is tidy, the others are messy."""


def learn_furniture(n_rooms: int, n_views: int, training: FurnitureTraining) -> FurnitureNetwork:
    """Train a network on ``n_views`` of each of ``n_rooms`` synthetic rooms of each kind."""
    console = Console(stderr=True)
    seeds = range(FIRST_SEED, FIRST_SEED + n_rooms)
    views = [
        view
        for seed in track(seeds, "Furniture", console=console)
        for view in _views(seed, n_views)
    ]
    return fit_furniture(
        views,
        len(PIECES),
        len(ROOM_KINDS),
        training,
        on_epoch=lambda done: console.print(f"pass {done} of {training.n_epochs}"),
    )


def _views(seed: int, n_views: int) -> Iterator[FurnitureView]:
    """Yield views of one room of each kind, as sensors drawn at random would have measured them."""
    rng = np.random.default_rng([seed, 22])
    for number, kind in enumerate(ROOM_KINDS):
        messy = seed % TIDY_EVERY != 0
        for frame, down, pieces in furnished_views(kind, seed, n_views, messy=messy):
            frame, gravity_camera, labels = remeasure_labelled(frame, pieces, rng, down)
            yield furniture_view(frame, labels, number, gravity_camera=gravity_camera)
