"""The node: topics in, the correction of the odometry and the map out."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path as PathMessage
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from slam_bof.errors import DatasetError, MapError, SlamBofError
from slam_bof.slam import MapOutline
from slam_bof.types import Step
from slam_bof_ros import outputs
from slam_bof_ros.frames import FrameSource, PosedFrame
from slam_bof_ros.mapper import Mapper, MapperSettings
from slam_bof_ros.parameters import PARAMETERS, check_parameter
from slam_bof_ros.transforms import TransformTree

__all__ = ["SlamBofNode", "main"]

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOSS = (
    "DDS loses messages of sensors on the way here: send large ones by another transport, or "
    "subscribe reliably (see the documentation)"
)


TOPICS: dict[str, tuple[type, str, Any]] = {
    "path": (PathMessage, "~/path", 1),
    "pose": (PoseWithCovarianceStamped, "~/pose", 10),
    "map_to_odom": (TransformStamped, "~/map_to_odom", 10),
    "graph": (MarkerArray, "~/graph", LATCHED),
    "map": (OccupancyGrid, "~/map", LATCHED),
    "cloud": (PointCloud2, "~/cloud", 10),
    "scene": (String, "~/scene", 10),
    "diagnostics": (DiagnosticArray, "/diagnostics", 10),
}
"""What the node publishes: type, topic, and quality of service or length of the queue."""


class SlamBofNode(Node):
    """Adds loop closing to the odometry of a robot with a depth camera."""

    def __init__(self, **options: Any) -> None:
        super().__init__("slam_bof", **options)
        for name, default in PARAMETERS.items():
            self.declare_parameter(name, default)
            check_parameter(name, self._value(name))
        self._tree = TransformTree()
        self._source = FrameSource(
            self._tree,
            odom_frame=self._value("odom_frame"),
            base_frame=self._value("base_frame"),
            uses_tf=self._value("use_tf"),
            uses_covariance=self._value("use_covariance"),
        )
        self._mapper = Mapper(
            MapperSettings(
                Path(self._value("map_file")).expanduser(),
                self._value("mode"),
                self._value("config"),
                # A robot's odometry has z up (REP 103).
                ("gravity_odom=[0,0,-1]", *filter(None, self._value("set"))),
                self._value("background"),
            )
        )
        self._n_drawn = self._n_lost = self._n_lost_before = 0
        self._publish: dict[str, Any] = {
            name: self.create_publisher(kind, topic, qos)
            for name, (kind, topic, qos) in TOPICS.items()
        }
        self._listen()
        self._connect_tf()
        for name, serve in (("save", self._save), ("finish", self._finish), ("reset", self._reset)):
            self.create_service(Trigger, f"~/{name}", self._answering(serve))
        self.create_service(SetBool, "~/pause", self._pause)
        self._start_timers()

    def _start_timers(self) -> None:
        """Publish the correction, the diagnostics, and pictures of the map from time to time."""
        self.create_timer(1.0 / self._value("tf_rate"), self._publish_tf)
        self.create_timer(1.0, self._publish_diagnostics)
        # A map that is not in a process of its own must not be read while frames are processed.
        drawing = MutuallyExclusiveCallbackGroup() if self._value("background") else None
        for period, draw in (
            ("graph_period_s", self._draw_graph),
            ("map_period_s", self._draw_map),
        ):
            if self._value(period) > 0.0:
                self.create_timer(self._value(period), draw, callback_group=drawing)

    def close(self) -> None:
        """Finish the map."""
        self._mapper.finish()
        self._mapper.closer.close()

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _listen(self) -> None:
        """Subscribe to depth and its camera, or to clouds, and to odometry."""
        if self._value("input") == "cloud":
            self._hear(PointCloud2, "cloud", self._on_cloud)
        else:
            kind = CompressedImage if self._value("compressed") else Image
            suffix = "/compressedDepth" if self._value("compressed") else ""
            self._hear(kind, f"depth/image_rect_raw{suffix}", self._on_image)
            self._hear(CameraInfo, "depth/camera_info", self._source.add_camera_info)
        if not self._value("use_tf"):
            self._hear(Odometry, "odom", self._on_odometry)

    def _hear(self, kind: type, topic: str, take: Callable[[Any], None]) -> None:
        """Subscribe as to a sensor, unless parameters say otherwise; count what DDS loses."""
        self.create_subscription(
            kind,
            topic,
            take,
            qos_profile_sensor_data,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._on_lost),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _on_lost(self, info: Any) -> None:
        self._n_lost += info.total_count_change

    def _connect_tf(self) -> None:
        """Listen to tf and publish it, if its messages are installed, as with every ROS."""
        self._tf: Callable[[TransformStamped], None] | None = None
        if importlib.util.find_spec("tf2_msgs") is None:
            self.get_logger().warning("tf2_msgs is not installed: no tf, see ~/map_to_odom")
            return
        from tf2_msgs.msg import TFMessage

        for topic, is_static, qos in (("/tf", False, 100), ("/tf_static", True, LATCHED)):
            self.create_subscription(
                TFMessage,
                topic,
                lambda message, is_static=is_static: self._tree.add(
                    message.transforms, is_static=is_static
                ),
                qos,
            )
        publisher = self.create_publisher(TFMessage, "/tf", 100)
        self._tf = lambda transform: publisher.publish(TFMessage(transforms=[transform]))

    def _on_image(self, message: Any) -> None:
        try:
            self._source.add_image(
                message,
                is_compressed=self._value("compressed"),
                is_rectified=self._value("rectified"),
            )
        except DatasetError as error:
            self._warn(str(error))
        self._process()

    def _on_cloud(self, message: PointCloud2) -> None:
        try:
            self._source.add_cloud(message)
        except DatasetError as error:
            self._warn(str(error))
        self._process()

    def _on_odometry(self, message: Odometry) -> None:
        self._source.add_odometry(message)
        self._process()

    def _process(self) -> None:
        for posed in self._source.take():
            try:
                step = self._mapper.process(posed)
            except SlamBofError as error:
                self.get_logger().error(str(error))
                continue
            if step is not None:
                self._publish_step(posed)

    def _publish_step(self, posed: PosedFrame) -> None:
        """Publish where the camera is, and what new keyframes show."""
        step, T_map_odom = self._mapper.step, self._mapper.T_map_odom
        if step is not None and T_map_odom is not None and not step.is_lost:
            T_map_camera = T_map_odom @ posed.T_odom_camera
            self._publish["pose"].publish(
                outputs.pose_message(
                    posed.frame.stamp_s, self._value("map_frame"), T_map_camera, step
                )
            )
        self._publish_keyframes()

    def _publish_keyframes(self) -> None:
        """Publish cloud and scene of the keyframes that have come into the map."""
        new = self._mapper.take_keyframes()
        step, T_map_odom = self._mapper.step, self._mapper.T_map_odom
        if not new or step is None or T_map_odom is None:
            return
        for posed in new:
            T_map_camera = T_map_odom @ posed.T_odom_camera
            self._publish["cloud"].publish(
                outputs.cloud_message(self._value("map_frame"), posed.frame, T_map_camera)
            )
        scene = (step.keyframe and step.keyframe.smoothed) or step.scene
        if scene is not None:
            self._publish["scene"].publish(outputs.scene_message(scene))

    def _publish_tf(self) -> None:
        """Publish the correction of the odometry; tf holds it until ``tf_ahead_s`` from now."""
        step = self._poll()
        self._publish_keyframes()
        T_map_odom = self._mapper.T_map_odom
        if step is None or T_map_odom is None:
            return
        stamp_s = self._now_s() + self._value("tf_ahead_s")
        message = outputs.transform_message(
            stamp_s, self._value("map_frame"), self._source.odom_frame, T_map_odom
        )
        self._publish["map_to_odom"].publish(message)
        if self._tf is not None:
            self._tf(message)

    def _poll(self) -> Step | None:
        try:
            return self._mapper.poll()
        except SlamBofError as error:
            self._warn(str(error))
            return self._mapper.step

    def _publish_diagnostics(self) -> None:
        mapper, health = self._mapper, self._mapper.health
        problem = self._source.problem or (health.errors[-1] if health.errors else "")
        if health.last == "lost":
            problem = "odometry is lost: it agrees with nothing seen before"
        health.errors = []
        if self._n_lost > self._n_lost_before:
            self._n_lost_before = self._n_lost
            problem = problem or LOSS
        values = {
            **health.values(),
            "keyframes waiting": str(mapper.closer.n_waiting),
            "frames while too many keyframes waited": str(mapper.closer.n_postponed),
            "images waiting for odometry": str(self._source.n_waiting),
            "images without odometry": str(self._source.n_dropped),
            "messages lost on the way": str(self._n_lost),
            "located": str(mapper.is_located),
            "odometry lost": str(mapper.closer.n_odometry_lost),
        }
        self._publish["diagnostics"].publish(
            outputs.diagnostics_message(
                self._now_s(), self.get_fully_qualified_name(), problem, health.last, values
            )
        )

    def _draw_graph(self) -> None:
        """Publish path and graph if there are new keyframes."""
        outline = self._outline(n_known=self._n_drawn)
        if outline is None:
            return
        self._n_drawn = len(outline)
        stamp_s, frame = self._now_s(), self._value("map_frame")
        self._publish["path"].publish(outputs.path_message(stamp_s, frame, outline))
        self._publish["graph"].publish(outputs.graph_message(stamp_s, frame, outline))

    def _draw_map(self) -> None:
        """Publish the occupancy grid of the saved keyframes."""
        outline = self._outline()
        if outline is None:
            return
        try:
            grid = self._mapper.occupancy(outline, self._value("max_map_keyframes"))
        except MapError as error:
            self.get_logger().debug(str(error))
            return
        self._publish["map"].publish(
            outputs.grid_message(self._now_s(), self._value("map_frame"), grid)
        )

    def _outline(self, *, n_known: int = 0) -> MapOutline | None:
        """Return the map if it is open and has another number of keyframes than this."""
        try:
            if self._mapper.is_finished or len(self._mapper.closer.map) == n_known:
                return None
            return self._mapper.outline()
        except SlamBofError as error:
            self._warn(str(error))
            return None

    def _save(self) -> str:
        path = self._mapper.settings.map_file.with_suffix(".saved.db")
        return f"{self._mapper.save(path)} keyframes in {path}"

    def _finish(self) -> str:
        n_frames = self._mapper.finish()
        return f"{n_frames} frames in {self._mapper.settings.map_file}"

    def _reset(self) -> str:
        self._mapper.reset()
        return "a new session has begun"

    def _pause(self, request: Any, response: Any) -> Any:
        self._mapper.is_paused = request.data
        response.success, response.message = True, "paused" if request.data else "going on"
        return response

    def _answering(self, serve: Callable[[], str]) -> Callable[[Any, Any], Any]:
        """Return a service of a function that returns what it did, or raises why it did not."""

        def answer(_: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, serve()
            except (SlamBofError, OSError) as error:
                response.success, response.message = False, str(error)
            return response

        return answer

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=5.0)

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)


def main(arguments: list[str] | None = None) -> None:
    """Run the node until it is interrupted; then finish the map."""
    rclpy.init(args=arguments)
    try:
        node = SlamBofNode()
    except SlamBofError as error:
        sys.exit(f"slam_bof_node: {error}")
    executor = MultiThreadedExecutor(num_threads=2)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
