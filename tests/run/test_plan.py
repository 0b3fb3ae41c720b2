"""The plans of a map: one for each component."""

import numpy as np
from saved_maps import make_keyframe, make_loop, save

from slam_bof.geometry import se3
from slam_bof.run import read_plans
from slam_bof.store import MapStore, SessionResult


def test_each_component_has_a_plan_the_largest_first(tmp_path):
    """Keyframes 0 and 1, and 2 to 5, which are of two segments that a loop joins."""
    with MapStore.create(tmp_path / "map.db") as store:
        for k, segment in enumerate([0, 0, 1, 1, 2, 2]):
            keyframe = make_keyframe(k)
            object.__setattr__(keyframe, "segment", segment)
            save(store, keyframe, [], [make_loop(5, 2)] if k == 5 else [])
        poses = np.array([se3.pose(np.eye(3), [float(k), 0.0, 0.0]) for k in range(6)])
        assert read_plans(store) == [], "of an unfinished map"
        store.finish(0, SessionResult([], poses, [None] * 6, []))
        plans = read_plans(store)
    assert [plan.ways for plan in plans] == [[[2, 3, 4, 5]], [[0, 1]]]
    for plan in plans:
        assert {0, 254} <= set(np.unique(plan.cells).tolist())
        np.testing.assert_array_equal(plan.positions_map, poses[:, :3, 3])
    assert plans[0].cells.shape != plans[1].cells.shape
