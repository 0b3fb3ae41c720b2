"""ROS bags: depth images of one topic with their CameraInfo, and poses if wished.

ROS 1 ``.bag`` files, ROS 2 folders with ``metadata.yaml`` (SQLite or MCAP), and single ``.mcap``
and ``.db3`` files. Depth is 16UC1 in mm or 32FC1 in m, raw or compressed (see ``bag_images``),
unless a RealSense bag or the option ``depth_scale`` states another unit. The depth topic is found
by its coding, if there is only one; the camera is the ``camera_info`` beside it, or else the only
one of the same frame. Times and order are those of the messages'
headers, without images whose stamp is broken or repeats another; where many stamps are broken,
those of their reception. Needs ``pip install slam-bof[bag]``.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_depth, checked_intrinsics
from slam_bof.types import Array, DepthFrame, Intrinsics, Params, Trajectory
from slam_bof_plugins.bag_file import BagFile, Topic, bag_kind, find_bag, open_bag
from slam_bof_plugins.bag_images import decode_depth
from slam_bof_plugins.bag_poses import recorded_poses
from slam_bof_plugins.bag_times import order_by_stamp
from slam_bof_plugins.bag_topics import OPTION, find_depth_topic, stated_units
from slam_bof_plugins.dataset_files import scale_depth, sequence_name
from slam_bof_plugins.ros_messages import apply_binning, camera_matrix, scale_center

__all__ = ["BagParams", "RosBag"]

logger = logging.getLogger(__name__)

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


class BagParams(Params):
    """The topics of a bag to read."""

    topic: str | None = Field(
        None, description="Topic of the depth images; by default the only one in the bag."
    )
    camera_info: str | None = Field(
        None,
        description="Topic of the camera's intrinsics; by default the camera_info beside the "
        "images.",
    )
    intrinsics: tuple[float, float, float, float] | None = Field(
        None, description="Intrinsics fx, fy, cx, cy in pixels, used instead of a camera_info."
    )
    depth_scale: float | None = Field(
        None,
        gt=0,
        allow_inf_nan=False,
        description="Units of depth per metre; by default those that a RealSense bag states, or "
        "else 1000 for integers and 1 for floats.",
    )
    groundtruth: str | None = Field(
        None,
        description="Topic of odometry, poses or tf to take as the true poses; by default there "
        "are none.",
    )
    world_frame: str = Field("map", description="Frame that poses from tf refer to.")
    camera_frame: str | None = Field(
        None, description="Frame of tf that moves; by default the frame of the depth images."
    )
    max_gap_s: float = Field(
        0.2,
        gt=0,
        description="True poses farther apart than this many seconds are not interpolated.",
    )


class RosBag:
    """The depth images of one topic of a ROS bag."""

    name: ClassVar[str] = "bag"
    Params = BagParams

    def __init__(self, bag: BagFile, topic: Topic, params: BagParams) -> None:
        self.sequence = sequence_name(bag.path.with_suffix(""))
        self._bag = bag
        self._topic = topic
        self._received, stamped = bag.times(topic.name)
        self._units_per_m = params.depth_scale or stated_units(bag, topic)
        self._order, self._stamps_s = _times(bag, topic, self._received, stamped)
        first = bag.first(topic.name)
        shape = decode_depth(first, topic.msgtype, self._where(0)).shape
        self.intrinsics = _camera(bag, topic, first, shape, params)
        self._groundtruth: Trajectory | None = None
        if params.groundtruth is not None:
            self._groundtruth = recorded_poses(
                bag,
                params.groundtruth,
                self._stamps_s,
                camera_frame=params.camera_frame or str(first.header.frame_id),
                world_frame=params.world_frame,
                max_gap_s=params.max_gap_s,
            )
            if np.isnan(self._groundtruth.poses).any(axis=(1, 2)).all():
                raise DatasetError(
                    f"{bag.path}: {params.groundtruth}: found no pose near the time of any frame, "
                    "expected some"
                )

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return the kind of bag; empty if it is none."""
        bags = find_bag(path)
        kind = bag_kind(bags[0]) if bags else ""
        more = f" in {len(bags)} parts" if len(bags) > 1 else ""
        return f"{bags[0].name}: {kind}{more}" if kind else ""

    @classmethod
    def open(cls, path: Path, params: BagParams | None = None) -> Self:
        """Open a bag, and read it through once for the times of its images.

        Raises
        ------
        DatasetError
            If it is no bag or damaged; if there is no depth topic, no camera, or several of them
            and none was named.
        """
        params = params or BagParams()
        bag = open_bag(path)
        return cls(bag, find_depth_topic(bag, params.topic), params)

    def __len__(self) -> int:
        """Return the number of depth images."""
        return len(self._stamps_s)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame: uint16 mm of 16UC1, float32 m of 32FC1 and of other units."""
        index = range(len(self))[index]
        number = int(self._order[index])
        message = self._bag.message(self._topic.name, number, self._received)
        depth = decode_depth(message, self._topic.msgtype, self._where(number))
        expected = (self.intrinsics.height, self.intrinsics.width)
        if depth.shape != expected:
            raise DatasetError(
                f"{self._where(number)}: found {depth.shape[1]}x{depth.shape[0]} pixels, "
                f"expected {expected[1]}x{expected[0]}"
            )
        if self._units_per_m is not None:
            is_integer = depth.dtype == np.uint16
            depth = (scale_depth if is_integer else np.divide)(depth, self._units_per_m)
        depth = checked_depth(self._where(number), depth, is_unit_known=False)
        return DepthFrame(float(self._stamps_s[index]), depth, self.intrinsics)

    def color(self, index: int) -> None:
        """Return None: colour cameras of bags are not registered to depth."""

    def gray(self, index: int) -> None:
        """Return None."""

    def groundtruth(self) -> Trajectory | None:
        """Return the poses of the chosen topic, NaN for frames without a pose near in time."""
        return self._groundtruth

    def scenes(self) -> None:
        """Return None: no labels."""

    def _where(self, index: int) -> str:
        return f"{self._bag.path}: {self._topic.name}, image {index}"


def _times(
    bag: BagFile, topic: Topic, received: NDArray[np.int64], stamped: NDArray[np.int64]
) -> tuple[NDArray[np.intp], Array]:
    """Return the order of the images (N,) and their times (N,) in seconds."""
    where = f"{bag.path}: {topic.name}"
    times, order = stamped, order_by_stamp(stamped, received)
    if order is None:
        logger.warning("%s: stamps do not grow; taking times of reception", where)
        times, order = received, order_by_stamp(received, received)
    if order is None:
        raise DatasetError(
            f"{where}: found the same time for many of {len(received)} images, "
            "expected times that grow"
        )
    if len(order) < len(stamped):
        missing = np.setdiff1d(np.arange(len(stamped)), order)
        logger.warning(
            "%s: %d of %d images have a broken or repeated time and are left out, the first: "
            "image %d at %.3f s",
            where,
            len(missing),
            len(stamped),
            missing[0],
            times[missing[0]] * 1e-9,
        )
    return order, np.asarray(times[order] / 1e9, np.float64)


def _camera(
    bag: BagFile, topic: Topic, first: Any, shape: tuple[int, ...], params: BagParams
) -> Intrinsics:
    height, width = shape
    if params.intrinsics is not None:
        return checked_intrinsics("dataset.options.intrinsics", width, height, *params.intrinsics)
    name = params.camera_info or _beside(bag, topic, str(first.header.frame_id))
    known = {item.name for item in bag.topics if item.msgtype == CAMERA_INFO}
    info = bag.first(name) if name in known else None
    if info is None:
        raise DatasetError(
            f"{bag.path}: found no camera_info {name}, expected one of: "
            f"{', '.join(sorted(known)) or 'none here'}"
        )
    K, is_distorted = camera_matrix(info, is_rectified="rect" in topic.name)
    if is_distorted:
        logger.warning("%s: %s: lens distortion is not undone", bag.path, name)
    numbers = apply_binning(info, K, width, height)
    if numbers is None:
        given = [float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))]
        share = width / info.width if info.width else 1.0
        fx, fy, cx, cy = (
            given[0] * share,
            given[1] * share,
            *(scale_center(c, share) for c in given[2:]),
        )
        raise DatasetError(
            f"{bag.path}: {name}: found a camera of {info.width}x{info.height} pixels, "
            f"expected {width}x{height} as {topic.name}; if the images were made smaller, give "
            f"{OPTION}.intrinsics=[{fx:.6g},{fy:.6g},{cx:.6g},{cy:.6g}]"
        )
    return checked_intrinsics(f"{bag.path}: {name}", width, height, *numbers)


def _beside(bag: BagFile, topic: Topic, frame: str) -> str:
    """Return the camera_info next to the images, or else the only one, or of the same frame."""
    infos = [item.name for item in bag.topics if item.msgtype == CAMERA_INFO and item.n_messages]
    above = topic.name
    for _ in range(2):  # .../image_raw and .../image_raw/compressedDepth
        above = above.rpartition("/")[0]
        for name in (f"{above}/camera_info", f"{above}/info/camera_info"):
            if name in infos:
                return name
    if len(infos) > 1:
        infos = [name for name in infos if bag.first(name).header.frame_id == frame] or infos
    if len(infos) == 1:
        logger.info("%s: taking %s for %s", bag.path, infos[0], topic.name)
        return infos[0]
    listed = ", ".join(infos) or "none"
    raise DatasetError(
        f"{bag.path}: found camera_info topics: {listed}, expected one beside {topic.name}; "
        f"give {OPTION}.camera_info=TOPIC or {OPTION}.intrinsics=[fx,fy,cx,cy]"
    )
