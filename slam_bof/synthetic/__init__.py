"""A synthetic world: furnished rooms, a flat with a tour, and a depth-sensor model.

Open3D, which casts the rays, is imported when the first ``Scene3D`` is made.
"""

from slam_bof.synthetic.brisk import make_brisk_tour, write_brisk_tour
from slam_bof.synthetic.corridor import make_corridor, make_corridor_tour, write_corridor
from slam_bof.synthetic.flat import make_flat, make_tour
from slam_bof.synthetic.lidar import Lidar, LidarParams
from slam_bof.synthetic.rooms import ROOM_KINDS, make_room
from slam_bof.synthetic.scene import KINECT, Scene3D
from slam_bof.synthetic.sensor import SensorParams, sense
from slam_bof.synthetic.tour import Waypoint, camera_poses, spin, walk
from slam_bof.synthetic.views import training_views
from slam_bof.synthetic.writer import write_flat, write_sequence

__all__ = [
    "KINECT",
    "ROOM_KINDS",
    "Lidar",
    "LidarParams",
    "Scene3D",
    "SensorParams",
    "Waypoint",
    "camera_poses",
    "make_brisk_tour",
    "make_corridor",
    "make_corridor_tour",
    "make_flat",
    "make_room",
    "make_tour",
    "sense",
    "spin",
    "training_views",
    "walk",
    "write_brisk_tour",
    "write_corridor",
    "write_flat",
    "write_sequence",
]
