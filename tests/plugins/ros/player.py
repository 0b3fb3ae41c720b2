"""Publish depth images, their camera and odometry from a file, as a robot would.

    python player.py FRAMES.npz PERIOD_S

Waits until someone listens to each topic, plays once and ends.
"""

import array
import sys
import time

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from slam_bof.geometry import se3
from slam_bof_ros.outputs import time_message

CAMERA_FRAME = "camera_depth_optical_frame"


def main(file, period_s):
    content = np.load(file)
    width, height, fx, fy, cx, cy = content["camera"].tolist()
    rclpy.init()
    node = Node("player")
    publishers = [
        node.create_publisher(CameraInfo, "depth/camera_info", 10),
        node.create_publisher(Odometry, "odom", 10),
        node.create_publisher(Image, "depth/image_rect_raw", 10),
    ]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.05)
    info = CameraInfo(width=int(width), height=int(height))
    info.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    info.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    for _ in range(5):  # until both sides know of each other
        publishers[0].publish(info)
        time.sleep(0.2)
    for stamp_s, depth, T in zip(
        content["stamps_s"], content["depths"], content["poses"], strict=True
    ):
        image = Image(height=int(height), width=int(width), encoding="16UC1", step=2 * int(width))
        image.data = array.array("B", depth.tobytes())
        odometry = Odometry(child_frame_id=CAMERA_FRAME)
        odometry.header.frame_id = "odom"
        t, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        t.x, t.y, t.z = T[:3, 3].tolist()
        q.x, q.y, q.z, q.w = se3.to_quaternion(T).tolist()
        for message in (info, image, odometry):
            message.header.stamp = time_message(float(stamp_s))
        info.header.frame_id = image.header.frame_id = CAMERA_FRAME
        for publisher, message in zip(publishers, (info, odometry, image), strict=True):
            publisher.publish(message)
        time.sleep(period_s)
    time.sleep(1.0)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
