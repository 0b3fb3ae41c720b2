"""The plans of a run's map for its report."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.errors import MapError
from slam_bof.maps import OccupancyGrid, build_occupancy_grid
from slam_bof.slam import config as configs
from slam_bof.store import MapStore, components_of
from slam_bof.types import Array
from slam_bof.visualization import Plan

__all__ = ["read_plans"]

MAX_KEYFRAMES = 300
"""Number of keyframes that a plan is drawn by, evenly chosen of all."""
MAX_PLANS = 4
"""Number of components, the largest ones, that plans are drawn of."""


def read_plans(store: MapStore) -> list[Plan]:
    """Draw plans of the largest components of a finished map, without those that show no walls."""
    T_map_camera, components = store.map_poses(), components_of(store)
    if not len(components) or not np.isfinite(T_map_camera).all():
        return []
    sessions = [keyframe.session for keyframe in store.keyframes()]
    config = configs.parse_saved(store.sessions()[-1].config, f"{store.path}: last session")
    starts = np.flatnonzero(np.diff(components) | np.diff(sessions)) + 1
    ways = np.split(np.arange(len(components)), starts)
    numbers, counts = np.unique(components, return_counts=True)
    plans = []
    for component in numbers[np.argsort(-counts, kind="stable")][:MAX_PLANS].tolist():
        inside = np.flatnonzero(components == component)
        grid = _draw_grid(store, inside, T_map_camera, config.gravity_odom)
        if grid is not None:
            plan = Plan(
                cells=grid.cells,
                resolution_m=grid.resolution_m,
                origin_m=grid.origin_m,
                T_plan_map=grid.T_plan_map,
                positions_map=T_map_camera[:, :3, 3],
                rooms=[r for r in store.rooms() if set(r.keyframe_ids) <= set(inside.tolist())],
                ways=[way.tolist() for way in ways if components[way[0]] == component],
            )
            plans.append(plan)
    return plans


def _draw_grid(
    store: MapStore, inside: NDArray[np.intp], T_map_camera: Array, gravity_map: ArrayLike
) -> OccupancyGrid | None:
    """Draw the occupancy grid of a component by some of its keyframes; None without walls."""
    ids = inside[:: -(-len(inside) // MAX_KEYFRAMES)].tolist()
    views = {k: store.view(k) for k in ids}
    frames = {k: view for k, view in views.items() if view is not None}
    try:
        return build_occupancy_grid(
            frames.values(), T_map_camera[list(frames)], gravity_map=gravity_map
        )
    except MapError:
        return None
