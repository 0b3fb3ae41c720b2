"""The plan of a run's map for its report."""

from __future__ import annotations

import numpy as np

from slam_bof.errors import MapError
from slam_bof.maps import build_occupancy_grid
from slam_bof.slam import config as configs
from slam_bof.store import MapStore, components_of, largest_component
from slam_bof.visualization import Plan

__all__ = ["read_plan"]

MAX_KEYFRAMES = 300
"""Number of keyframes that the plan is drawn by, evenly chosen of all."""


def read_plan(store: MapStore) -> Plan | None:
    """Draw the plan of the largest component of a finished map; None if it shows no walls."""
    T_map_camera, components = store.map_poses(), components_of(store)
    if not len(components) or not np.isfinite(T_map_camera).all():
        return None
    largest = np.flatnonzero(components == largest_component(components))
    ids = largest[:: -(-len(largest) // MAX_KEYFRAMES)].tolist()
    views = {k: store.view(k) for k in ids}
    frames = {k: view for k, view in views.items() if view is not None}
    config = configs.parse_saved(store.sessions()[-1].config, f"{store.path}: last session")
    try:
        grid = build_occupancy_grid(
            frames.values(), T_map_camera[list(frames)], gravity_map=config.gravity_odom
        )
    except MapError:
        return None
    inside = set(largest.tolist())
    return Plan(
        cells=grid.cells,
        resolution_m=grid.resolution_m,
        origin_m=grid.origin_m,
        T_plan_map=grid.T_plan_map,
        positions_map=T_map_camera[:, :3, 3],
        rooms=[room for room in store.regions() if inside.issuperset(room.keyframe_ids)],
    )
