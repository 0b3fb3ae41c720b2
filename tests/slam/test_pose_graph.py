"""Shortest paths in the pose graph: over so far the map may have drifted."""

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.slam.pose_graph import MapGraph
from slam_bof.types import Bag, CandidateSource, EdgeKind, Keyframe, Loop
from slam_bof_plugins.backend_gtsam import GtsamBackend

EMPTY = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


def at(x_m):
    return se3.pose(np.eye(3), [x_m, 0.0, 0.0])


def loop(query_id, match_id, x_m):
    kind, source = EdgeKind.LOOP, CandidateSource.VIEW
    return Loop(query_id, match_id, at(x_m), 1e4 * np.eye(6), kind, source)


@pytest.fixture
def there_and_back():
    """Keyframes at 0, 1, 2, 3, 2, 1 and 0.5 m along a line."""
    graph = MapGraph(GtsamBackend())
    for k, x_m in enumerate((0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.5)):
        graph.add_keyframe(Keyframe(k, k, float(k), at(x_m), EMPTY, None))
        graph.add_loops([])
    return graph


def test_without_loops_the_shortest_path_is_the_one_travelled(there_and_back):
    np.testing.assert_allclose(
        there_and_back.shortest_paths_m(), [5.5, 4.5, 3.5, 2.5, 1.5, 0.5, 0.0]
    )


def test_a_loop_makes_the_path_shorter(there_and_back):
    there_and_back.add_loops([loop(6, 1, -0.5), loop(6, 5, -0.5)])
    path_m = there_and_back.shortest_paths_m()
    np.testing.assert_allclose(path_m, [1.5, 0.5, 1.5, 2.5, 1.5, 0.5, 0.0], atol=1e-3)


def test_an_edge_longer_than_the_step_beside_it_does_not_count(there_and_back):
    there_and_back.add_loops([loop(6, 5, -3.0)])
    assert there_and_back.shortest_paths_m()[5] == pytest.approx(0.5, abs=0.1)


def test_two_keyframes_at_one_place_are_linked(there_and_back):
    there_and_back.add_loops([loop(5, 1, 0.0)])
    np.testing.assert_allclose(there_and_back.shortest_paths_m()[:2], [1.5, 0.5], atol=1e-3)


def test_paths_lead_past_culled_keyframes(there_and_back):
    there_and_back.add_loops([loop(5, 1, 0.0)])
    there_and_back.cull({5: 1}, 10)
    path_m = there_and_back.shortest_paths_m()
    assert np.isinf(path_m[5])
    assert path_m[4] == pytest.approx(1.5, abs=0.01)
