"""The ROS 2 package of slam_bof, built by colcon."""

from glob import glob

from setuptools import setup

NAME = "slam_bof_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{folder}", glob(f"{folder}/*"))
            for folder in ("launch", "config", "rviz")
        ),
    ],
    install_requires=["setuptools", "slam-bof"],
    zip_safe=True,
    maintainer="The slam_bof authors",
    maintainer_email="slam_bof@example.com",
    description="Depth-only loop closing, map correction and scene labels beside any odometry.",
    license="MIT",
    entry_points={"console_scripts": ["slam_bof_node = slam_bof_ros.node:main"]},
)
