import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.places import Localizer, RecogniserParams
from slam_bof.places.localizer import LocalizationParams
from slam_bof.synthetic import Scene3D, make_room
from slam_bof.synthetic.tour import camera_poses
from slam_bof.types import DepthFrame, Intrinsics
from slam_bof_plugins.verifier_projective import ProjectiveVerifier

N_ROUND = 18
ASIDE = se3.exp(np.array([0.05, 0.1, -0.04, 0.12, -0.06, 0.08]))


def all_around(x, y, n):
    """Poses at a place, in as many directions."""
    yaws = 2 * np.pi / n * np.arange(n)
    return np.array([camera_poses([x, y, 1.4], yaw, 0.15, 0.0) for yaw in yaws])


def rendered(mesh, poses, camera):
    scene = Scene3D(mesh, camera)
    return [DepthFrame(float(k), scene.view(T).depth_m, camera) for k, T in enumerate(poses)]


def hold(frames, T_map_camera, **options):
    localizer = Localizer(ProjectiveVerifier(), **options)
    ids = [localizer.add(f, T) for f, T in zip(frames, T_map_camera, strict=True)]
    assert ids == list(range(len(frames)))
    return localizer


@pytest.fixture(scope="module")
def turn(look, standpoint):
    """Views all around from one place, and their poses in the map of the first."""
    T_world_camera = all_around(*standpoint, N_ROUND)
    frames = [look(T, index) for index, T in enumerate(T_world_camera)]
    return frames, T_world_camera, se3.inverse(T_world_camera[0]) @ T_world_camera


@pytest.fixture(scope="module")
def localizer(turn):
    frames, _, T_map_camera = turn
    return hold(frames, T_map_camera)


@pytest.fixture(scope="module")
def aside(look, turn):
    """Views from aside, and where in the map they were taken."""
    _, T_world_camera, T_map_camera = turn
    frames = [look(T_world_camera[k] @ ASIDE, 100 + k) for k in (1, 6, 11)]
    return frames, T_map_camera[[1, 6, 11]] @ ASIDE


def assert_is_at(found, T_map_camera):
    assert found.is_known, found.reason
    error = se3.inverse(T_map_camera) @ found.T_map_camera
    assert np.linalg.norm(error[:3, 3]) < 0.03
    assert np.degrees(se3.rotation_angle(error)) < 0.6


def test_frames_from_aside_are_localised(localizer, aside):
    for frame, T_map_camera in zip(*aside, strict=True):
        found = localizer.localize(frame)
        assert_is_at(found, T_map_camera)
        assert found.reason == ""
        assert found.overlap > 0.4
        assert found.rmse_m < 0.03
        assert found.keyframe_id not in found.supporting_ids
        assert 0 <= found.keyframe_id < N_ROUND


@pytest.mark.parametrize("error_m", [0.0, 0.13])
def test_a_pose_that_the_map_contradicts_once_refined_is_not_known(look, turn, standpoint, error_m):
    """The keyframe that refines the pose saw the middle of the image; the map has it too far on."""
    frames, T_world_camera, T_map_camera = turn
    T_world_query = camera_poses([*standpoint, 1.4], np.radians(30.0), 0.15, 0.0)
    T_map_query = se3.inverse(T_world_camera[0]) @ T_world_query
    query = look(T_world_query, 200)
    middle = np.zeros_like(query.depth)
    middle[:, 160:480] = query.depth[:, 160:480]
    poses = [*T_map_camera, T_map_query @ se3.pose(np.eye(3), [0.0, 0.0, error_m])]
    keyframes = [*frames, DepthFrame(1.0, middle, query.intrinsics)]
    refined_by_one = LocalizationParams(n_refined=1)
    found = hold(keyframes, poses, params=refined_by_one).localize(query)
    if error_m == 0.0:
        assert_is_at(found, T_map_query)
    else:
        assert not found.is_known
        assert "at the refined pose the free space" in found.reason


def test_each_frame_is_asked_for_by_itself(localizer, turn, aside):
    frames, _ = aside
    first = [localizer.localize(frame) for frame in frames]
    again = [localizer.localize(frame) for frame in reversed(frames)][::-1]
    fresh = hold(turn[0], turn[2])
    afresh = [fresh.localize(frame) for frame in frames]
    for a, b, c in zip(first, again, afresh, strict=True):
        assert a.T_map_camera.tobytes() == b.T_map_camera.tobytes() == c.T_map_camera.tobytes()
        assert a.supporting_ids == b.supporting_ids == c.supporting_ids
    assert len(localizer) == N_ROUND


def test_every_fourth_pixel_is_enough(turn, aside):
    def thinned(frame):
        depth = np.zeros_like(frame.depth)
        depth[::4, ::4] = frame.depth[::4, ::4]
        return DepthFrame(frame.stamp_s, depth, frame.intrinsics)

    frames, _, T_map_camera = turn
    sparse = hold([thinned(frame) for frame in frames], T_map_camera)
    whole = hold(frames, T_map_camera)
    one, other = (
        lo.localize(f) for lo, f in ((sparse, thinned(aside[0][0])), (whole, aside[0][0]))
    )
    np.testing.assert_array_equal(one.T_map_camera, other.T_map_camera)


def test_the_map_may_be_anywhere(turn, aside):
    frames, _, T_map_camera = turn
    T_other_map = se3.exp(np.array([0.0, 1.0, 0.0, 5.0, -2.0, 3.0]))
    moved = hold(frames, T_other_map @ T_map_camera)
    assert_is_at(moved.localize(aside[0][0]), T_other_map @ aside[1][0])


def test_another_room_is_not_known(localizer, turn):
    other = make_room("kitchen", seed=8)
    width, depth, _ = other.size
    camera = turn[0][0].intrinsics
    poses = all_around(width / 2, depth / 2, 6)
    for frame in rendered(other.mesh, poses, camera):
        found = localizer.localize(frame)
        assert not found.is_known
        assert found.reason
        assert found.keyframe_id is None


@pytest.mark.parametrize(("depth_mm", "reason"), [(0, "too little"), (1500, "keyframe")])
def test_nothing_and_a_bare_wall_are_not_known(localizer, turn, depth_mm, reason):
    blank = np.full_like(turn[0][0].depth, depth_mm)
    found = localizer.localize(DepthFrame(0.0, blank, turn[0][0].intrinsics))
    assert not found.is_known
    assert reason in found.reason


def test_a_map_without_keyframes_knows_nothing(turn):
    found = Localizer(ProjectiveVerifier()).localize(turn[0][0])
    assert found.reason == "the map has no keyframes"


def test_a_place_that_is_twice_in_the_map_is_not_localised(turn, aside):
    frames, _, T_map_camera = turn
    beside = se3.pose(np.eye(3), [0.0, 0.0, 50.0])
    twice = hold([*frames, *frames], np.concatenate([T_map_camera, beside @ T_map_camera]))
    found = twice.localize(aside[0][0])
    assert not found.is_known
    assert re.search("places match the image|may as well be from", found.reason)


def test_a_double_known_by_other_keyframes_is_not_localised(turn, aside):
    """Of the second room only another part was seen than the one that the frame shows."""
    frames, _, T_map_camera = turn
    beside = se3.pose(np.eye(3), [0.0, 0.0, 50.0])
    apart = slice(4, 10)
    poses = np.concatenate([T_map_camera, beside @ T_map_camera[apart]])
    found = hold([*frames, *frames[apart]], poses).localize(aside[0][0])
    assert not found.is_known
    assert "may as well" in found.reason
    blind = LocalizationParams.model_validate({"aliases": {"n_near": 0}})
    assert hold([*frames, *frames[apart]], poses, params=blind).localize(aside[0][0]).is_known


def test_gravity_may_be_given(localizer, look, turn):
    _, T_world_camera, T_map_camera = turn
    on_its_side = se3.exp(np.array([0.0, 0.0, np.radians(80.0), 0.0, 0.0, 0.0]))
    pose = T_world_camera[1] @ on_its_side
    frame = look(pose, 200)
    assert not localizer.localize(frame).is_known
    found = localizer.localize(frame, gravity_camera=pose[:3, :3].T @ [0.0, 0.0, -1.0])
    assert_is_at(found, T_map_camera[1] @ on_its_side)


def test_bad_keyframes_are_refused(localizer, turn):
    frames, _, _ = turn
    with pytest.raises(ValueError, match="no rotation"):
        localizer.add(frames[0], np.diag([2.0, 2.0, 2.0, 1.0]))
    small = Intrinsics(160, 120, 100.0, 100.0, 80.0, 60.0)
    stranger = DepthFrame(0.0, np.full((120, 160), 1000, np.uint16), small)
    with pytest.raises(ValueError, match="views must be of"):
        localizer.localize(stranger)
    assert len(localizer) == N_ROUND
    assert localizer.localize(frames[3]).is_known


def test_less_may_be_looked_at(turn, aside):
    frames, _, T_map_camera = turn
    lazy = hold(frames, T_map_camera, recogniser_params=RecogniserParams(n_aligned=3))
    assert_is_at(lazy.localize(aside[0][0]), aside[1][0])


@pytest.mark.parametrize("T", [np.eye(4)[:3], 1j * np.eye(4), "here", None, np.full((4, 4), 1e300)])
def test_a_pose_that_is_none_is_refused_and_nothing_added(turn, T):
    """Of a localiser and of its recogniser."""
    localizer = Localizer(ProjectiveVerifier())
    for add in (localizer.add, localizer._recogniser.add):
        with pytest.raises(ValueError, match="found "):
            add(turn[0][0], T)
    with pytest.raises(ValueError, match="found "):
        localizer.add(turn[0][0], T, np.eye(4))
    assert localizer.add(turn[0][0], np.eye(4)) == 0


def test_threads_that_ask_at_once_get_the_answers_of_one(turn, aside):
    localizer = hold(turn[0], turn[2])
    frames = [*aside[0], *turn[0][:3]]
    expected = [localizer.localize(frame) for frame in frames]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(localizer.localize, [*frames, *frames]))
    for a, b in zip([*expected, *expected], found, strict=True):
        assert (a.keyframe_id, a.reason, a.supporting_ids) == (
            b.keyframe_id,
            b.reason,
            b.supporting_ids,
        )
        if a.is_known:
            np.testing.assert_array_equal(a.T_map_camera, b.T_map_camera)
    assert len(localizer) == N_ROUND
