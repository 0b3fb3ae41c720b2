"""Constellations of keyframes, as a map keeps them."""

from __future__ import annotations

from slam_bof.bof import ConstellationParams, IndexedView, describer_id
from slam_bof.types import Array, SavedConstellation, SensorParams

__all__ = ["restore_constellation", "save_constellation"]


def save_constellation(
    view: IndexedView, gravity_camera: Array, params: ConstellationParams, sensor: SensorParams
) -> SavedConstellation:
    """Return what a map keeps of a view that was described with these parameters."""
    describer = describer_id(params, sensor)
    return SavedConstellation(gravity_camera, describer, view.tobytes(), view.total)


def restore_constellation(
    saved: SavedConstellation | None, params: ConstellationParams, sensor: SensorParams
) -> IndexedView | None:
    """Return a view that was saved; None if it must be described, as by other parameters."""
    if saved is None or saved.describer != describer_id(params, sensor):
        return None
    view = IndexedView.of_bytes(saved.contours, saved.weight)
    slices = view.rows["slice"]
    is_plausible = len(view) <= params.max_contours  # of a map that somebody else has written
    is_plausible &= bool(((slices >= 0) & (slices < params.slices.n_slices)).all())
    return view if is_plausible else None
