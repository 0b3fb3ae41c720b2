"""Start the node; ``ros2 launch slam_bof_ros slam_bof.launch.py depth:=/camera/depth``."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

SHARE = Path(get_package_share_directory("slam_bof_ros"))


def generate_launch_description() -> LaunchDescription:
    """Return the node with its topics and parameters."""
    arguments = {
        "parameters": str(SHARE / "config" / "slam_bof.yaml"),
        "depth": "/camera/depth",
        "image": "image_rect_raw",
        "cloud": "/camera/points",
        "odom": "/odom",
        "map_file": "~/.ros/slam_bof/map.db",
        "mode": "mapping",
    }
    depth, image = LaunchConfiguration("depth"), LaunchConfiguration("image")
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value)
                for name, value in arguments.items()
            ),
            Node(
                package="slam_bof_ros",
                executable="slam_bof_node",
                name="slam_bof",
                output="screen",
                parameters=[
                    LaunchConfiguration("parameters"),
                    {name: LaunchConfiguration(name) for name in ("map_file", "mode")},
                ],
                remappings=[
                    ("depth/image_rect_raw", [depth, "/", image]),
                    # A topic below another one is not remapped with it.
                    (
                        "depth/image_rect_raw/compressedDepth",
                        [depth, "/", image, "/compressedDepth"],
                    ),
                    ("depth/camera_info", [depth, "/camera_info"]),
                    ("cloud", LaunchConfiguration("cloud")),
                    ("odom", LaunchConfiguration("odom")),
                ],
            ),
        ]
    )
