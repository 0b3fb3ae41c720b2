"""From messages to frames with poses, without ROS: any objects with the fields of messages."""

from types import SimpleNamespace as Message

import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.slam import LoopCloser
from slam_bof_plugins.ros_messages import seconds
from slam_bof_ros.frames import FrameSource, step_covariance
from slam_bof_ros.transforms import TransformTree

T_BASE_CAMERA = se3.exp(np.array([-1.2, 0.0, 0.0, 0.3, 0.0, 0.5]))
CAMERA_FRAME = "camera_depth_optical_frame"


def stamp(time_s):
    return Message(sec=int(time_s), nanosec=round(time_s % 1 * 1e9))


def header(time_s, frame):
    return Message(stamp=stamp(time_s), frame_id=frame)


def quaternion(T):
    return Message(**dict(zip("xyzw", se3.to_quaternion(T), strict=True)))


def point(T):
    return Message(**dict(zip("xyz", T[:3, 3], strict=True)))


def transform(time_s, parent, child, T):
    return Message(
        header=header(time_s, parent),
        child_frame_id=child,
        transform=Message(rotation=quaternion(T), translation=point(T)),
    )


def odometry(time_s, T, child="base_link", variance=0.0):
    return Message(
        header=header(time_s, "odom"),
        child_frame_id=child,
        pose=Message(pose=Message(orientation=quaternion(T), position=point(T))),
        twist=Message(covariance=(variance * np.eye(6)).ravel()),
    )


def image(time_s, depth=None):
    depth = np.full((12, 16), 1500, np.uint16) if depth is None else depth
    return Message(
        header=header(time_s, CAMERA_FRAME),
        height=depth.shape[0],
        width=depth.shape[1],
        step=2 * depth.shape[1],
        encoding="16UC1",
        is_bigendian=0,
        data=np.frombuffer(depth.tobytes(), np.uint8),
    )


def camera_info(width=16, height=12, distortion=0.0):
    K = np.array([14.0, 0, 7.5, 0, 14.0, 5.5, 0, 0, 1])
    P = np.insert(K.reshape(3, 3) * [2, 2, 1], 3, 0.0, axis=1)
    return Message(
        width=width, height=height, k=K, p=P.ravel(), d=np.array([distortion]), binning_x=0,
        binning_y=0, roi=Message(x_offset=0, y_offset=0, width=0, height=0),
    )  # fmt: skip


@pytest.fixture
def tree():
    tree = TransformTree()
    tree.add([transform(0.0, "base_link", CAMERA_FRAME, T_BASE_CAMERA)], is_static=True)
    return tree


def turn(time_s):
    return se3.exp(np.array([0.0, 0.0, 0.4 * time_s, time_s, 0.0, 0.0]))


def test_odometry_of_the_base_becomes_that_of_the_camera(tree):
    source = FrameSource(tree)
    source.add_camera_info(camera_info())
    for k in range(4):
        source.add_image(image(0.1 * k), is_rectified=False)
        source.add_odometry(odometry(0.1 * k, turn(0.1 * k)))
    posed = source.take()
    assert [round(p.frame.stamp_s, 3) for p in posed] == [0.0, 0.1, 0.2, 0.3]
    for p in posed:
        expected = turn(p.frame.stamp_s) @ T_BASE_CAMERA
        np.testing.assert_allclose(p.T_odom_camera, expected, atol=1e-9)
        assert p.covariance is None
    assert posed[0].frame.intrinsics.fx == 14.0
    assert source.take() == []


def test_odometry_may_come_before_image_and_mounting():
    source = FrameSource(TransformTree())
    source.add_camera_info(camera_info())
    for k in range(3):
        source.add_odometry(odometry(0.1 * k, turn(0.1 * k)))
        source.add_image(image(0.1 * k), is_rectified=False)
    assert source.take() == []
    source.tree.add([transform(0.0, "base_link", CAMERA_FRAME, T_BASE_CAMERA)], is_static=True)
    assert [round(p.frame.stamp_s, 3) for p in source.take()] == [0.0, 0.1, 0.2]


def test_poses_between_which_an_image_lies_are_interpolated(tree):
    source = FrameSource(tree)
    source.add_camera_info(camera_info())
    source.add_image(image(0.05), is_rectified=True)
    for k in range(4):
        source.add_odometry(odometry(0.1 * k, turn(0.1 * k)))
    (posed,) = source.take()
    np.testing.assert_allclose(posed.T_odom_camera, turn(0.05) @ T_BASE_CAMERA, atol=1e-3)
    assert posed.frame.intrinsics.fx == 28.0  # of the projection matrix


def test_poses_come_from_tf_where_that_is_wished(tree):
    source = FrameSource(tree, uses_tf=True)
    source.add_camera_info(camera_info())
    source.add_image(image(0.15), is_rectified=False)
    assert source.take() == []
    tree.add(
        [transform(t, "/odom", "base_link", turn(t)) for t in (0.0, 0.1, 0.2)], is_static=False
    )
    (posed,) = source.take()
    np.testing.assert_allclose(posed.T_odom_camera, turn(0.15) @ T_BASE_CAMERA, atol=1e-3)


def test_what_is_missing_is_said():
    source = FrameSource(TransformTree())
    with pytest.raises(DatasetError, match="found no camera_info yet"):
        source.add_image(image(0.0), is_rectified=False)
    source.add_camera_info(camera_info(width=20))
    with pytest.raises(DatasetError, match="found a camera of 20x12 pixels, expected 16x12"):
        source.add_image(image(0.0), is_rectified=False)
    source.add_camera_info(camera_info())
    source.add_image(image(0.0), is_rectified=False)
    source.add_odometry(odometry(0.0, np.eye(4)))
    assert source.take() == []
    assert source.problem == (
        f"found no transform from base_link to {CAMERA_FRAME}, expected one on /tf_static"
    )
    for k in range(100):
        source.add_image(image(0.1 + 0.1 * k), is_rectified=False)
    assert "too many images wait for odometry" in source.problem
    assert source.n_waiting == 64


def test_the_covariance_of_the_twist_becomes_that_of_the_step_in_the_camera(tree):
    """The camera's z is the base's x, turned by its mounting; a step of 0.1 s counts 0.01."""
    source = FrameSource(tree)
    source.add_camera_info(camera_info())
    for k in range(3):
        source.add_image(image(0.1 * k), is_rectified=False)
        source.add_odometry(odometry(0.1 * k, np.eye(4), variance=4.0))
    *_, posed = source.take()
    R = T_BASE_CAMERA[:3, :3].T
    rotations = posed.covariance[3:, 3:]
    np.testing.assert_allclose(rotations, R @ (0.04 * np.eye(3)) @ R.T, atol=1e-12)
    assert np.linalg.eigvalsh(posed.covariance)[0] > 0.0
    assert np.trace(posed.covariance[:3, :3]) > 3 * 0.04  # the lever arm adds
    frame = posed.frame
    LoopCloser.from_preset().process(frame, posed.T_odom_camera, posed.covariance)


def test_frames_far_apart_have_no_covariance():
    assert step_covariance([(0.9, np.eye(6))], 0.0, 1.0) is None
    assert step_covariance([(0.2, np.eye(6))], 0.3, 0.4) is None


def test_transforms_are_composed_over_common_ancestors(tree):
    T_base_arm = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    tree.add([transform(0.0, "base_link", "arm", T_base_arm)], is_static=True)
    found = tree.lookup("arm", CAMERA_FRAME, 5.0)
    np.testing.assert_allclose(found, se3.inverse(T_base_arm) @ T_BASE_CAMERA, atol=1e-9)
    assert tree.lookup("map", CAMERA_FRAME, 5.0) is None
    tree.add([transform(1.0, "odom", "base_link", turn(1.0))], is_static=False)
    assert tree.lookup("odom", CAMERA_FRAME, 5.0) is None, "too long after the last one"
    assert tree.lookup("odom", CAMERA_FRAME, 1.01) is not None


def test_broken_transforms_and_circles_do_no_harm(tree):
    broken = transform(0.0, "odom", "base_link", np.eye(4))
    broken.transform.rotation = Message(x=0.0, y=0.0, z=0.0, w=0.0)
    tree.add([broken], is_static=True)
    assert tree.lookup("odom", "base_link", 0.0) is None
    tree.add([transform(0.0, CAMERA_FRAME, "base_link", np.eye(4))], is_static=True)
    assert tree.lookup("odom", "base_link", 0.0) is None


def test_seconds_keep_their_nanoseconds():
    assert seconds(stamp(12.25)) == 12.25


def cloud(time_s, points, frame="lidar", padding=4):
    rows = np.zeros((len(points), 12 + padding), np.uint8)
    rows[:, padding:] = points.astype("<f4").view(np.uint8).reshape(len(points), 12)
    fields = [Message(name=n, offset=padding + 4 * k, datatype=7) for k, n in enumerate("xyz")]
    return Message(
        header=header(time_s, frame), fields=fields, is_bigendian=False, point_step=12 + padding,
        row_step=rows.size, width=len(points), height=1, data=rows.tobytes(),
    )  # fmt: skip


@pytest.mark.parametrize("frame", ["lidar", "lidar_optical_frame"])
def test_clouds_have_the_axes_of_a_body_unless_their_frame_is_an_optical_one(tree, frame):
    """Where a point is in the odometry frame does not depend on it."""
    T_base_lidar = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    tree.add([transform(0.0, "base_link", frame, T_base_lidar)], is_static=True)
    source = FrameSource(tree)
    points = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [-4.0, 5.0, 6.0]])
    source.add_cloud(cloud(0.0, points, frame))
    source.add_odometry(odometry(0.0, turn(0.0)))
    (posed,) = source.take()
    found = se3.transform(posed.T_odom_camera, posed.frame.points_camera)
    expected = se3.transform(turn(0.0) @ T_base_lidar, points[[0, 2]])
    np.testing.assert_allclose(found, expected, atol=1e-5)
    if frame == "lidar":
        np.testing.assert_allclose(posed.frame.points_camera[0], [-2.0, -3.0, 1.0], atol=1e-6)


def test_a_cloud_without_coordinates_is_refused(tree):
    message = cloud(0.0, np.ones((3, 3)))
    del message.fields[2]
    with pytest.raises(DatasetError, match="found fields x, y, expected x, y and z of float32"):
        FrameSource(tree).add_cloud(message)
