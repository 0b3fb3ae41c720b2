import cv2
import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.synthetic import Scene3D, make_flat, make_tour, spin, walk, write_flat
from slam_bof.synthetic.tour import Waypoint
from slam_bof.types import INVALID_DEPTH_MM, Intrinsics

SMALL = Intrinsics(40, 30, 36.5, 36.5, 20.0, 15.0)


@pytest.fixture(scope="module")
def flat():
    return make_flat(0)


@pytest.fixture(scope="module")
def tour(flat):
    return make_tour(flat)


def steps(poses):
    between = se3.inverse(poses[:-1]) @ poses[1:]
    return np.linalg.norm(between[:, :3, 3], axis=1), np.degrees(se3.rotation_angle(between))


def test_the_flat_has_four_rooms_of_different_kinds_off_a_corridor(flat):
    assert len({room.kind for room in flat.rooms}) == len(flat.rooms) == 4
    for room in flat.rooms:
        assert flat.kind_at(*(room.low + room.high) / 2) == room.kind
        assert flat.kind_at(room.door[0], room.door[1] - 0.5 * room.inward) == "corridor"


def test_the_tour_moves_as_hands_do(tour):
    metres, degrees = steps(tour)
    assert metres.max() < 0.04
    assert degrees.max() < 2.5
    np.testing.assert_allclose(
        tour[:, :3, :3] @ tour[:, :3, :3].swapaxes(1, 2), np.eye(3) + np.zeros((len(tour), 3, 3)),
        atol=1e-12,
    )  # fmt: skip


def test_the_tour_sees_every_room_and_comes_back(flat, tour):
    kinds = [flat.kind_at(x, y) for x, y in tour[:, :2, 3]]
    assert set(kinds) == {room.kind for room in flat.rooms} | {"corridor"}
    assert kinds[-1] == flat.rooms[0].kind
    late = tour[-150::10]
    distance = np.linalg.norm(late[:, None, :3, 3] - tour[None, :300, :3, 3], axis=-1)
    angle = np.degrees(se3.rotation_angle(se3.inverse(late)[:, None] @ tour[None, :300]))
    assert ((distance < 0.3) & (angle < 25)).any(axis=1).mean() > 0.8


@pytest.mark.parametrize("seed", [0, 1])
def test_every_view_holds_the_camera_in_all_directions(seed):
    flat = make_flat(seed)
    scene = Scene3D(flat.mesh, SMALL)
    corners = flat.mesh.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    for pose in make_tour(flat, seed=seed)[::20]:
        view = scene.view(pose)
        seen = (view.depth_m > 0.4) & (view.depth_m < 4.5)
        assert seen.mean() > 0.5
        assert view.depth_m[view.depth_m > 0].min() > 0.3
        normals = normal[view.triangle[seen]]
        assert np.linalg.eigvalsh(normals.T @ normals / view.depth_m.size)[0] > 0.01


def test_a_spin_turns_as_fast_as_asked():
    poses = spin(0.0, 0.0, rate_deg_s=90.0, angle_deg=180.0)
    _, degrees = steps(poses)
    assert np.median(degrees[20:70]) == pytest.approx(3.0, abs=0.3)
    assert poses[0, :3, 2] @ poses[-1, :3, 2] < -0.9


def test_a_walk_stays_between_its_way_points():
    poses = walk([Waypoint(0, 0, 0), Waypoint(2, 0, 0), Waypoint(2, 3, 1)])
    assert (poses[:, :2, 3] > -0.08).all()
    assert (poses[:, :2, 3] < (2.08, 3.08)).all()
    with pytest.raises(ValueError, match="at least 2 way points, got 1"):
        walk([Waypoint(0, 0, 0)])


def test_the_written_flat_has_the_layout_of_7_scenes(tmp_path, flat, tour):
    seen = []
    sequence = write_flat(tmp_path, n_frames=3, progress=lambda done, total: seen.append(done))
    assert seen == [1, 2, 3]
    assert sequence == tmp_path / "flat" / "seq-01"
    assert (sequence.parent / "TrainSplit.txt").read_text() == "sequence1\n"
    names = {path.name for path in sequence.iterdir()}
    parts = ("depth.png", "color.png", "pose.txt")
    assert names == {f"frame-{i:06d}.{part}" for i in range(3) for part in parts} | {"scenes.csv"}
    assert (sequence / "scenes.csv").read_text().splitlines()[:2] == ["frame,scene", "0,corridor"]
    depth = cv2.imread(str(sequence / "frame-000002.depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    np.testing.assert_allclose(np.loadtxt(sequence / "frame-000002.pose.txt"), tour[2], atol=1e-8)
    true_mm = 1000 * Scene3D(flat.mesh).view(tour[2]).depth_m
    valid = (depth > 0) & (depth < INVALID_DEPTH_MM)
    assert valid.mean() > 0.4
    assert np.median(np.abs(depth[valid] - true_mm[valid])) < 20


def test_the_same_seed_writes_the_same_bytes_and_a_whole_one_is_kept(tmp_path):
    first, second = (write_flat(tmp_path / name, n_frames=2) for name in "ab")
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes()
    untouched = (first / "frame-000000.depth.png").stat().st_mtime_ns
    assert write_flat(tmp_path / "a", n_frames=2) == first
    assert (first / "frame-000000.depth.png").stat().st_mtime_ns == untouched


def test_an_interrupted_flat_leaves_nothing_and_strangers_stay(tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_flat(tmp_path / "a", n_frames=2, progress=interrupt)
    assert list((tmp_path / "a").iterdir()) == []
    mine = tmp_path / "b" / "flat"
    mine.mkdir(parents=True)
    (mine / "diary.txt").write_text("mine")
    with pytest.raises(DatasetError, match=r"flat: found other files"):
        write_flat(tmp_path / "b", n_frames=2)
    assert (mine / "diary.txt").read_text() == "mine"
