import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.synthetic import Scene3D, camera_poses, write_twin
from slam_bof.synthetic.twin import gravity_aligned, make_twin_room, read_poses
from slam_bof.types import Intrinsics

SMALL = Intrinsics(64, 48, 58.5, 58.5, 32.0, 24.0)


@pytest.fixture(scope="module")
def level():
    """A sway before a table, in a level world."""
    t = np.linspace(0.0, 6.0, 40)
    position = np.stack([0.5 * np.sin(t), 0.3 * np.cos(2 * t), 0.2 * np.sin(3 * t)], axis=1)
    return camera_poses(position, np.pi / 2 + 0.8 * np.sin(t), 0.5 + 0.4 * np.cos(t))


def lines(poses, numbers, sequence="seq-03"):
    """As the pose files have it: world-to-camera, w first."""
    inverted = se3.inverse(poses)
    xyzw = se3.to_quaternion(inverted)
    rows = np.column_stack([xyzw[:, 3], xyzw[:, :3], inverted[:, :3, 3]])
    return "".join(
        f"{sequence}/frame-{n:06d}.color.png " + " ".join(map(repr, map(float, row))) + " 525.0\n"
        for n, row in zip(numbers, rows, strict=True)
    )


def test_poses_are_read_from_both_files_inverted_and_in_order(tmp_path, level):
    train, test = tmp_path / "train.txt", tmp_path / "test.txt"
    train.write_text(lines(level[:1], [7]) + lines(level[1:2], [3], "seq-01"))
    test.write_text(lines(level[2:3], [2]))
    numbers, poses = read_poses([train, test], "seq-03")
    assert numbers == [2, 7]
    np.testing.assert_allclose(poses, level[[2, 0]], atol=1e-12)


def test_bad_pose_files_are_named(tmp_path):
    file = tmp_path / "poses.txt"
    with pytest.raises(DatasetError, match=r"poses.txt: found No such file"):
        read_poses([file], "seq-03")
    file.write_text("seq-03/frame-000001.color.png 1 2 3\n")
    with pytest.raises(DatasetError, match=r"expected seq-XX/frame-N and 8 numbers"):
        read_poses([file], "seq-03")
    file.write_text("")
    with pytest.raises(DatasetError, match=r"found no frame of seq-03"):
        read_poses([file], "seq-03")


def test_gravity_is_found_in_a_tilted_world(level):
    tilted = se3.exp(np.array([2.0, -0.7, 0.4, 1.0, 2.0, 3.0])) @ level
    aligned = gravity_aligned(tilted)
    np.testing.assert_allclose(aligned[:, 2, :3], level[:, 2, :3], atol=1e-9)
    between = se3.inverse(tilted[:-1]) @ tilted[1:]
    np.testing.assert_allclose(se3.inverse(aligned[:-1]) @ aligned[1:], between, atol=1e-12)


def test_the_room_stands_where_cameras_look_and_not_where_they_are(level):
    mesh = make_twin_room(level, seed=1)
    low, high = mesh.bounds()
    position = level[:, :3, 3]
    assert (low < position.min(axis=0) - 0.6).all()
    assert (high > position.max(axis=0) + 0.6).all()
    scene = Scene3D(mesh, SMALL)
    for pose in level[::4]:
        view = scene.view(pose)
        assert view.depth_m.min() > 0.3
        assert len(np.unique(view.triangle)) > 15


def test_a_twin_keeps_frame_numbers_and_counts_the_missing(tmp_path, level):
    file = tmp_path / "poses" / "chess.txt"
    file.parent.mkdir()
    numbers = [4, 5, 8]
    file.write_text(lines(level[:3], numbers))
    sequence, n_missing = write_twin(tmp_path / "out", [file])
    assert sequence == tmp_path / "out" / "chess-twin" / "seq-03"
    assert n_missing == 2
    assert sorted(p.name for p in sequence.glob("*.depth.png")) == [
        f"frame-{n:06d}.depth.png" for n in numbers
    ]
    assert (sequence.parent / "TestSplit.txt").read_text() == "sequence3\n"
    written = np.stack([np.loadtxt(sequence / f"frame-{n:06d}.pose.txt") for n in numbers])
    np.testing.assert_allclose(written, gravity_aligned(level[:3]), atol=1e-8)


def test_the_twin_of_another_sequence_is_not_replaced(tmp_path, level):
    file = tmp_path / "poses" / "chess.txt"
    file.parent.mkdir()
    file.write_text(lines(level[:3], [4, 5, 8]))
    other = tmp_path / "out" / "chess-twin" / "seq-02"
    other.mkdir(parents=True)
    (other.parent / "recipe.json").write_text("{}")
    with pytest.raises(
        DatasetError, match="found the twin of seq-02, expected none or that of seq-03"
    ):
        write_twin(tmp_path / "out", [file])
    assert other.is_dir()


def test_the_real_chess_trajectory_fits_its_room(shared_data):
    folder = shared_data / "7scenes-poses" / "dslam"
    numbers, poses = read_poses([folder / f"chess_{s}.txt" for s in ("train", "test")], "seq-03")
    assert numbers == list(range(1000))
    poses = gravity_aligned(poses)
    scene = Scene3D(make_twin_room(poses), SMALL)
    near = [scene.view(pose).depth_m.min() for pose in poses[::25]]
    assert min(near) > 0.4
