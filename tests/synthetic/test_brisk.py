import cv2
import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.synthetic import Scene3D, make_brisk_tour, make_flat
from slam_bof.synthetic.brisk import find_blackouts
from slam_bof.synthetic.tour import FRAME_RATE_HZ
from slam_bof.synthetic.writer import write_sequence


@pytest.fixture(scope="module", params=[0, 1])
def flat(request):
    return make_flat(request.param)


@pytest.fixture(scope="module")
def tour(flat):
    return make_brisk_tour(flat)


def test_it_turns_at_120_degrees_a_second(tour):
    turned = se3.rotation_angle(se3.inverse(tour[:-1]) @ tour[1:])
    rate_deg_s = np.degrees(turned) * FRAME_RATE_HZ
    assert 115 < rate_deg_s.max() < 130
    assert (rate_deg_s > 100).sum() > 2 * FRAME_RATE_HZ


def test_the_lens_is_covered_once_in_a_turn_and_once_in_the_hallway(flat, tour):
    dark = find_blackouts(flat, tour)
    assert len(dark) == 2 * FRAME_RATE_HZ
    first, second = np.split(dark, 2)
    assert (np.diff(first) == 1).all()
    assert (np.diff(second) == 1).all()
    missed = se3.inverse(tour[first[0] - 1]) @ tour[first[-1] + 1]
    assert np.degrees(se3.rotation_angle(missed)) > 90
    assert {flat.kind_at(x, y) for x, y in tour[first, :2, 3]} == {"kitchen"}
    assert {flat.kind_at(x, y) for x, y in tour[second, :2, 3]} == {"corridor"}
    assert np.linalg.norm(tour[second[-1], :3, 3] - tour[second[0], :3, 3]) > 0.5


def test_a_covered_lens_sees_nothing_but_has_a_pose(tmp_path):
    flat = make_flat(0)
    poses = make_brisk_tour(flat)[:2]
    write_sequence(tmp_path, Scene3D(flat.mesh), poses, frame_numbers=[7, 8], dark={8})
    depth, dark = (
        cv2.imread(str(tmp_path / f"frame-{i:06d}.depth.png"), cv2.IMREAD_UNCHANGED) for i in (7, 8)
    )
    assert (depth > 0).mean() > 0.5
    assert dark.dtype == np.uint16
    assert (dark == 0).all()
    assert (cv2.imread(str(tmp_path / "frame-000008.color.png")) == 0).all()
    np.testing.assert_allclose(np.loadtxt(tmp_path / "frame-000008.pose.txt"), poses[1], atol=1e-8)
