"""From the map to messages: path, graph, occupancy grid, cloud, scene and diagnostics."""

from __future__ import annotations

import colorsys
import json
import zlib
from collections.abc import Iterable, Mapping

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Pose as PoseMessage,
    PoseStamped,
    PoseWithCovarianceStamped,
    TransformStamped,
)
from nav_msgs.msg import OccupancyGrid as GridMessage, Path
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from slam_bof.geometry import se3, view_points
from slam_bof.maps import OccupancyGrid
from slam_bof.slam import MapOutline
from slam_bof.types import DepthFrame, Pose, Scene, Step
from slam_bof_ros.frames import Cloud

__all__ = [
    "cloud_message",
    "diagnostics_message",
    "graph_message",
    "grid_message",
    "path_message",
    "pose_message",
    "scene_message",
    "transform_message",
]

OCCUPANCY = {254: 0, 0: 100, 205: -1}
"""nav_msgs by the grey values of map_server."""


def time_message(stamp_s: float) -> Time:
    """Return a time."""
    nanoseconds = round(stamp_s * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def transform_message(stamp_s: float, frame: str, child: str, T: Pose) -> TransformStamped:
    """Return ``T_frame_child`` as tf has it."""
    message = TransformStamped(
        header=Header(stamp=time_message(stamp_s), frame_id=frame), child_frame_id=child
    )
    t, q = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z = T[:3, 3].tolist()
    q.x, q.y, q.z, q.w = se3.to_quaternion(T).tolist()
    return message


def pose_message(
    stamp_s: float, frame: str, T_map_camera: Pose, step: Step
) -> PoseWithCovarianceStamped:
    """Return the pose of the camera with its covariance, along and about the axes of the map."""
    message = PoseWithCovarianceStamped(header=Header(stamp=time_message(stamp_s), frame_id=frame))
    message.pose.pose = _pose(T_map_camera)
    if step.covariance is not None:
        turned = np.kron(np.eye(2), T_map_camera[:3, :3])
        message.pose.covariance = (turned @ step.covariance @ turned.T).ravel().tolist()
    return message


def path_message(stamp_s: float, frame: str, map_: MapOutline) -> Path:
    """Return the poses of all keyframes."""
    header = Header(stamp=time_message(stamp_s), frame_id=frame)
    return Path(
        header=header,
        poses=[
            PoseStamped(
                header=Header(stamp=time_message(keyframe_s), frame_id=frame), pose=_pose(T)
            )
            for keyframe_s, T in zip(map_.stamps_s.tolist(), map_.T_map_camera, strict=True)
        ],
    )


def graph_message(stamp_s: float, frame: str, map_: MapOutline) -> MarkerArray:
    """Return keyframes in the colours of their labels, edges, loops, and the names of rooms."""
    positions = map_.T_map_camera[:, :3, 3]
    consecutive = np.flatnonzero(np.diff(map_.components) == 0)
    odometry = [(k, k + 1) for k in consecutive.tolist()]
    loops, others = map_.edges[map_.is_loop].tolist(), map_.edges[~map_.is_loop].tolist()
    header = Header(stamp=time_message(stamp_s), frame_id=frame)

    def marker(name: str, kind: int, width_m: float, color: ColorRGBA) -> Marker:
        made = Marker(header=header, ns=name, type=kind, action=Marker.ADD, color=color)
        made.pose.orientation.w = 1.0
        made.scale.x = made.scale.y = made.scale.z = width_m
        return made

    keyframes = marker("keyframes", Marker.SPHERE_LIST, 0.06, _color("unknown"))
    keyframes.points = [_point(p) for p in positions]
    keyframes.colors = [_color(label) for label in map_.labels]
    lines = []
    for name, pairs, width_m, color in (
        ("odometry", odometry, 0.02, ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)),
        ("covisibility", others, 0.01, ColorRGBA(r=0.3, g=0.5, b=0.9, a=0.5)),
        ("loops", loops, 0.02, ColorRGBA(r=0.1, g=0.8, b=0.2, a=1.0)),
    ):
        line = marker(name, Marker.LINE_LIST, width_m, color)
        line.points = [_point(positions[k]) for pair in pairs for k in pair]
        lines.append(line)
    names = []
    for room in map_.rooms:
        text = marker("rooms", Marker.TEXT_VIEW_FACING, 0.3, _color(room.label))
        text.id, text.text, text.pose.position = room.id, room.label, _point(room.center_m)
        names.append(text)
    clear = Marker(header=header, action=Marker.DELETEALL)
    return MarkerArray(markers=[clear, keyframes, *lines, *names])


def grid_message(stamp_s: float, frame: str, grid: OccupancyGrid) -> GridMessage:
    """Return an occupancy grid whose axes are those of the map as nearly as can be."""
    cells, (x, y) = grid.cells[::-1], grid.origin_m
    T_map_plan = se3.inverse(grid.T_plan_map)
    n_quarters = round(np.arctan2(T_map_plan[1, 0], T_map_plan[0, 0]) / (np.pi / 2)) % 4
    for _ in range(n_quarters):  # plan's y becomes the other way along x
        x, y = -(y + grid.resolution_m * cells.shape[0]), x
        cells = cells.T[:, ::-1]
    turned = se3.exp(np.array([0.0, 0.0, -np.pi / 2 * n_quarters, 0.0, 0.0, 0.0]))
    origin = T_map_plan @ turned @ se3.pose(np.eye(3), [x, y, 0.0])
    message = GridMessage(header=Header(stamp=time_message(stamp_s), frame_id=frame))
    message.info.resolution = grid.resolution_m
    message.info.height, message.info.width = cells.shape
    message.info.origin = _pose(origin)
    values = np.full(256, -1, np.int8)
    values[list(OCCUPANCY)] = list(OCCUPANCY.values())
    message.data = values[cells].ravel().tolist()
    return message


def cloud_message(frame: str, seen: DepthFrame | Cloud, T_map_camera: Pose) -> PointCloud2:
    """Return the points of a depth frame or cloud in the map."""
    points_camera = seen.points_camera if isinstance(seen, Cloud) else view_points(seen)
    points = se3.transform(T_map_camera, points_camera.astype(np.float64)).astype("<f4")
    fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, name in enumerate("xyz")
    ]
    return PointCloud2(
        header=Header(stamp=time_message(seen.stamp_s), frame_id=frame),
        height=1, width=len(points), fields=fields, is_bigendian=False, point_step=12,
        row_step=12 * len(points), data=points.tobytes(), is_dense=True,
    )  # fmt: skip


def scene_message(scene: Scene) -> String:
    """Return the label and the probability of each class, as JSON."""
    probabilities = dict(zip(scene.classes, scene.probabilities.round(4).tolist(), strict=True))
    content = {
        "label": scene.label,
        "probability": round(scene.probability, 4),
        "probabilities": probabilities,
    }
    return String(data=json.dumps(content))


def diagnostics_message(
    stamp_s: float, name: str, problem: str, summary: str, values: Mapping[str, str]
) -> DiagnosticArray:
    """Return the state of the node; a warning if there is a problem."""
    level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
    status = DiagnosticStatus(
        level=level,
        name=name,
        message=problem or summary,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=Header(stamp=time_message(stamp_s)), status=[status])


def _pose(T: Pose) -> PoseMessage:
    message = PoseMessage(position=_point(T[:3, 3]))
    q = message.orientation
    q.x, q.y, q.z, q.w = se3.to_quaternion(T).tolist()
    return message


def _point(p: Iterable[float]) -> Point:
    x, y, z = (float(value) for value in p)
    return Point(x=x, y=y, z=z)


def _color(label: str) -> ColorRGBA:
    """Return the colour of a label, always the same one."""
    if label == "unknown":
        return ColorRGBA(r=0.6, g=0.6, b=0.6, a=1.0)
    hue = zlib.crc32(label.encode()) % 360 / 360
    r, g, b = colorsys.hsv_to_rgb(hue, 0.8, 0.9)
    return ColorRGBA(r=r, g=g, b=b, a=1.0)
