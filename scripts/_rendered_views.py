"""Views of synthetic rooms, rendered once and kept in a folder: rendering is most of training."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path

import numpy as np

from slam_bof.geometry import view_points
from slam_bof.synthetic import (
    Flat,
    Scene3D,
    make_flat,
    make_tour,
    messy_views,
    sense,
    training_views,
)
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose

__all__ = ["RenderedViews"]

View = tuple[DepthFrame, Array | None]
_NEARER, _POINT_STRIDE = 0.9, 97
ARRAYS = ("depth", "stamps_s", "down", "camera")


class RenderedViews:
    """Renders views, or reads them from ``folder`` if it has them; without one nothing is kept.

    A file holds the depth of all views of a room without loss, so what is trained does not depend
    on where the views are from.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder

    def tidy(self, kind: str, seed: int, n_views: int) -> Iterator[View]:
        """Yield ``training_views``, without gravity."""
        views = ((frame, None) for frame in training_views(kind, seed, n_views))
        yield from self._kept(f"tidy-{kind}-{seed}", n_views, views)

    def messy(self, kind: str, seed: int, n_views: int) -> Iterator[View]:
        """Yield ``messy_views``, with gravity."""
        yield from self._kept(f"messy-{kind}-{seed}", n_views, messy_views(kind, seed, n_views))

    def tour(self, seed: int, n_views: int) -> Iterator[tuple[DepthFrame, str]]:
        """Yield frames along the tour of a flat, each with the kind of room that most of it shows.

        Through a door that is the next room, as the smoothing of labels expects.
        """
        flat = make_flat(seed)
        tour = make_tour(flat, seed=seed)
        poses = tour[np.linspace(0, len(tour) - 1, n_views).round().astype(int)]

        def render() -> Iterator[View]:
            scene, rng = Scene3D(flat.mesh), np.random.default_rng([seed, 13])
            for k, T_world_camera in enumerate(poses):
                view = scene.view(T_world_camera)
                depth = sense(view.depth_m, view.returned, rng)
                yield DepthFrame(float(k), depth, scene.intrinsics), None

        views = self._kept(f"tour-{n_views}-{seed}", n_views, render())
        for (frame, _), T_world_camera in zip(views, poses, strict=True):
            yield frame, _kind_seen(flat, frame, T_world_camera)

    def _kept(self, name: str, n_views: int, views: Iterator[View]) -> Iterator[View]:
        if self._folder is None:
            yield from views
            return
        path = self._folder / f"{name}.npz"
        found = list(_read(path))
        if len(found) < n_views:
            found = list(views)
            _write(path, found)
        yield from found[:n_views]


def _kind_seen(flat: Flat, frame: DepthFrame, T_world_camera: Pose) -> str:
    """Return the kind of room that most points are in, each a tenth nearer, before its wall."""
    points_camera = _NEARER * view_points(frame)[::_POINT_STRIDE]
    points = points_camera @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    return Counter(flat.kind_at(x, y) for x, y in points[:, :2].tolist()).most_common(1)[0][0]


def _read(path: Path) -> Iterator[View]:
    if not path.is_file():
        return
    with np.load(path) as stored:
        depths, stamps_s, downs, camera = (stored[name] for name in ARRAYS)
    width, height, *others = camera.tolist()
    intrinsics = Intrinsics(int(width), int(height), *others)
    for depth, stamp_s, down in zip(depths, stamps_s.tolist(), downs, strict=True):
        yield DepthFrame(stamp_s, depth, intrinsics), down if down.any() else None


def _write(path: Path, views: list[View]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    with unfinished.open("wb") as file:
        np.savez_compressed(
            file,
            depth=[frame.depth for frame, _ in views],
            stamps_s=[frame.stamp_s for frame, _ in views],
            down=[np.zeros(3) if down is None else down for _, down in views],
            camera=astuple(views[0][0].intrinsics),
        )
    os.replace(unfinished, path)
