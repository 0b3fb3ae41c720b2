"""Bags written by rosbags' own writers, in all three formats, and read back."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, check_dataset, pose, ramp, refusal
from numpy.typing import NDArray

from slam_bof import registry, se3
from slam_bof.errors import DatasetError

pytest.importorskip("rosbags", reason="needs pip install slam-bof[bag]")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORES[1].register(  # which is not among those that come along for ROS 1
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
FORMATS = ["ros1", "sqlite3", "mcap"]
START_NS = 1_700_000_000_000_000_000
TOPIC = "/camera/depth/image_rect_raw"
INFO = "/camera/depth/camera_info"
FRAME = "camera_depth_optical_frame"


class Bag:
    """Writes messages of either ROS by the same few calls."""

    def __init__(self, version: int, writer: Any) -> None:
        self.store = STORES[version]
        self._version = version
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def write(self, topic: str, time_ns: int, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=self.store
            )
        serialise = self.store.serialize_ros1 if self._version == 1 else self.store.serialize_cdr
        self._writer.write(
            self._connections[topic], time_ns, serialise(message, message.__msgtype__)
        )

    def stamp(self, time_ns: int) -> Any:
        sec, nanosec = divmod(time_ns, 10**9)
        return self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def header(self, time_ns: int, frame: str = FRAME) -> Any:
        more = {"seq": 0} if self._version == 1 else {}
        stamp = self.stamp(time_ns)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def image(
        self, topic: str, time_ns: int, image: NDArray[Any], encoding: str, *, pad: int = 0,
        big: bool = False, stamp_ns: int | None = None, received_ns: int | None = None,
    ) -> None:  # fmt: skip
        data = image.astype(image.dtype.newbyteorder(">" if big else "<"))
        rows = data.view(np.uint8).reshape(image.shape[0], -1)
        rows = np.hstack([rows, np.full((len(rows), pad), 255, np.uint8)])
        message = self.make(
            "sensor_msgs/msg/Image",
            header=self.header(time_ns if stamp_ns is None else stamp_ns),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.ravel(),
        )
        self.write(topic, received_ns or time_ns + 5_000_000, message)

    def compressed(self, topic: str, time_ns: int, data: bytes, coding: str) -> None:
        message = self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(time_ns),
            format=coding,
            data=np.frombuffer(data, np.uint8),
        )
        self.write(topic, time_ns, message)

    def camera(self, topic: str, *, size: tuple[int, int] = (WIDTH, HEIGHT), fx: float = 30.0,
               frame: str = FRAME) -> None:  # fmt: skip
        K = np.array([fx, 0, 16, 0, 31, 12, 0, 0, 1], float)
        P = np.array([fx, 0, 16, 0, 0, 31, 12, 0, 0, 0, 1, 0], float)
        names = ("D", "K", "R", "P") if self._version == 1 else ("d", "k", "r", "p")
        matrices = dict(zip(names, (np.zeros(5), K, np.eye(3).ravel(), P), strict=True))
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
            do_rectify=False,
        )  # fmt: skip
        message = self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(START_NS, frame), width=size[0],
            height=size[1], distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi,
            **matrices,
        )  # fmt: skip
        self.write(topic, START_NS, message)

    def geometry(self, T: NDArray[np.float64]) -> tuple[Any, Any]:
        """Make the translation and the quaternion of a pose."""
        x, y, z, w = se3.to_quaternion(T).tolist()
        q = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        return T[:3, 3].tolist(), q

    def odometry(self, topic: str, time_ns: int, T: NDArray[np.float64], child: str) -> None:
        (x, y, z), q = self.geometry(T)
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        message = self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(time_ns, "odom"),
            child_frame_id=child,
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self.make(
                    "geometry_msgs/msg/Pose",
                    position=self.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
                    orientation=q,
                ),
                covariance=np.zeros(36),
            ),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )
        self.write(topic, time_ns, message)

    def tf(self, topic: str, time_ns: int, parent: str, child: str, T: Any) -> None:
        (x, y, z), q = self.geometry(T)
        item = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time_ns, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=q,
            ),
        )
        self.write(topic, time_ns, self.make("tf2_msgs/msg/TFMessage", transforms=[item]))


@contextmanager
def writing(folder: Path, form: str, packing: str = "") -> Iterator[tuple[Bag, Path]]:
    if form == "ros1":
        path = folder / "toy.bag"
        old = Writer1(path)
        if packing:
            old.set_compression(Writer1.CompressionFormat[packing])
        with old:
            yield Bag(1, old), path
    else:
        path = folder / f"toy_{form}"
        new = Writer2(path, version=9, storage_plugin=StoragePlugin[form.upper()])
        if packing:
            new.set_compression(CompressionMode[packing], CompressionFormat.ZSTD)
        with new:
            yield Bag(2, new), path


def time_ns(number: float) -> int:
    return START_NS + round(number * 33_333_333)


def write(folder: Path, form: str, packing: str = "", *, n: int = 4, **options: Any) -> Path:
    """Write ramps of 16UC1 with their camera, and images of another camera in between."""
    with writing(folder, form, packing) as (bag, path):
        bag.camera(INFO)
        for number in range(n):
            bag.image("/camera/color", time_ns(number) + 7, np.zeros((4, 4), np.uint8), "mono8")
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1", **options)
    return path


@pytest.mark.parametrize("form", FORMATS)
def test_reads_what_was_written(tmp_path: Path, form: str) -> None:
    path = write(tmp_path, form, pad=6)
    dataset = registry.open_dataset(path)
    assert (dataset.name, len(dataset)) == ("bag", 4)
    check_dataset(dataset)
    for number in (0, 3, 1, 2, 3):
        frame = dataset.frame(number)
        assert frame.stamp_s == pytest.approx(time_ns(number) * 1e-9, abs=1e-6)
        assert frame.depth.dtype == np.uint16
        np.testing.assert_array_equal(frame.depth, ramp(number))
    camera = dataset.intrinsics
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 31, 16, 12)


@pytest.mark.parametrize(
    ("form", "packing"),
    [
        ("ros1", "BZ2"),
        ("ros1", "LZ4"),
        ("sqlite3", "MESSAGE"),
        ("sqlite3", "FILE"),
        ("mcap", "MESSAGE"),
        ("mcap", "FILE"),
        ("mcap", "STORAGE"),
    ],
)
def test_packed_bags_are_read(tmp_path: Path, form: str, packing: str) -> None:
    dataset = registry.open_dataset(write(tmp_path, form, packing))
    check_dataset(dataset)
    for number in (3, 1, 2):
        np.testing.assert_array_equal(dataset.frame(number).depth, ramp(number))


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_a_single_file_of_ros_2_is_a_bag(tmp_path: Path, form: str) -> None:
    suffix = {"sqlite3": ".db3", "mcap": ".mcap"}[form]
    (file,) = write(tmp_path, form).glob(f"*{suffix}")
    alone = file.rename(tmp_path / f"alone{suffix}")
    assert len(registry.open_dataset(alone)) == 4
    assert registry.recognise_dataset(alone).why.startswith("alone.")


@pytest.mark.parametrize("form", ["ros1", "mcap"])
@pytest.mark.parametrize("big", [False, True])
def test_both_byte_orders_and_both_units(tmp_path: Path, form: str, big: bool) -> None:
    metres = ramp() / np.float32(1000)
    metres[0, :2] = (np.nan, np.inf)
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), metres, "32FC1", big=big, pad=3)
        bag.image(TOPIC, time_ns(1), ramp(), "16UC1", big=big)
    dataset = registry.open_dataset(path)
    assert dataset.frame(0).depth.dtype == np.float32
    np.testing.assert_array_equal(dataset.frame(0).depth, metres)
    assert dataset.frame(0).depth_m()[0, :2].tolist() == [0, 0]
    np.testing.assert_array_equal(dataset.frame(1).depth, ramp())


def png(image: NDArray[np.uint16]) -> bytes:
    return bytes(cv2.imencode(".png", image)[1].tobytes())


def rvl(image: NDArray[np.uint16]) -> bytes:
    """Encode as the paper's listing does, number by number."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    pixels, at, previous = image.ravel().tolist(), 0, 0
    while at < len(pixels):
        for missing in (True, False):
            end = at
            while end < len(pixels) and (pixels[end] == 0) == missing:
                end += 1
            put(end - at)
            if missing:
                at = end
        for pixel in pixels[at:end]:
            step = pixel - previous
            put(2 * step if step >= 0 else -2 * step - 1)
            previous = pixel
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        sum(nibble << 28 - 4 * k for k, nibble in enumerate(nibbles[i : i + 8]))
        for i in range(0, len(nibbles), 8)
    ]
    return struct.pack("<2i", image.shape[1], image.shape[0]) + struct.pack(
        f"<{len(words)}I", *words
    )


def holes() -> NDArray[np.uint16]:
    image = np.random.default_rng(0).integers(0, 65536, (HEIGHT, WIDTH)).astype(np.uint16)
    image[3:7, 5:] = 0
    image[-1, -5:] = 0
    return image


@pytest.mark.parametrize("form", ["ros1", "sqlite3"])
@pytest.mark.parametrize(
    ("coding", "code"),
    [
        ("16UC1; compressedDepth", lambda image: bytes(12) + png(image)),
        ("16UC1; compressedDepth png", lambda image: bytes(12) + png(image)),
        ("16UC1; compressedDepth rvl", lambda image: bytes(12) + rvl(image)),
        ("16UC1; png compressed ", png),
    ],
)
def test_compressed_depth(
    tmp_path: Path, form: str, coding: str, code: Callable[[NDArray[np.uint16]], bytes]
) -> None:
    topic = f"{TOPIC}/compressedDepth"
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        for number, image in enumerate((ramp(), holes())):
            bag.compressed(topic, time_ns(number), code(image), coding)
    dataset = registry.open_dataset(path)
    np.testing.assert_array_equal(dataset.frame(0).depth, ramp())
    np.testing.assert_array_equal(dataset.frame(1).depth, holes())


def test_compressed_metres_are_inverse_depth(tmp_path: Path) -> None:
    # As compressed_depth_image_transport has it: 10 m at most, quantised by 100.
    a = 100.0 * (100.0 + 1.0)
    b = 1.0 - a / 10.0
    metres = ramp() / np.float32(1000)
    with np.errstate(divide="ignore"):
        inverse = np.where(metres > 0, a / metres + b, 0).astype(np.uint16)
    data = struct.pack("<i2f", 0, a, b) + png(inverse)
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.compressed(f"{TOPIC}/compressedDepth", time_ns(0), data, "32FC1; compressedDepth png")
    depth = registry.open_dataset(path).frame(0).depth
    assert depth.dtype == np.float32
    assert depth[0, 0] == 0
    np.testing.assert_allclose(depth, metres, rtol=2e-3)


def test_raw_images_win_over_the_same_compressed(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), ramp(), "16UC1")
        bag.compressed(
            f"{TOPIC}/compressedDepth",
            time_ns(0),
            bytes(12) + png(ramp(1)),
            "16UC1; compressedDepth",
        )
    np.testing.assert_array_equal(registry.open_dataset(path).frame(0).depth, ramp(0))


def test_topics_are_chosen_by_options(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera("/a/camera_info", fx=40)
        bag.camera("/b/camera_info", fx=50, frame="other")
        for name, number in (("/a/depth", 1), ("/b/depth", 2), ("/b/color", 3)):
            bag.image(name, time_ns(0), ramp(number), "16UC1" if number < 3 else "bgr8x")
    said = refusal("bag", path)
    assert "found 2 depth topics: /a/depth (16UC1), /b/depth (16UC1), expected one" in said
    assert "--set dataset.options.topic=/a/depth" in said
    dataset = registry.open_dataset(path, "bag", {"topic": "/b/depth"})
    assert dataset.intrinsics.fx == 50
    assert dataset.frame(0).depth[0, 1] == 3001
    options = {"topic": "/b/depth", "camera_info": "/a/camera_info"}
    assert registry.open_dataset(path, "bag", options).intrinsics.fx == 40
    given = {"topic": "/b/depth", "intrinsics": [9, 8, 7, 6]}
    assert registry.open_dataset(path, "bag", given).intrinsics.cy == 6
    assert "found no images on /c, expected one of: /a/depth, /b/color, /b/depth" in refusal(
        "bag", path, topic="/c"
    )
    assert "found images coded as bgr8x, expected 16UC1" in refusal("bag", path, topic="/b/color")
    assert "found no camera_info /c, expected one of: /a/" in refusal(
        "bag", path, topic="/a/depth", camera_info="/c"
    )


def test_recordings_of_the_realsense_viewer(tmp_path: Path) -> None:
    sensor = "/device_0/sensor_0"
    with writing(tmp_path, "ros1", "LZ4") as (bag, path):
        for name, fx in (("Depth_0", 40.0), ("Infrared_1", 50.0)):
            bag.camera(f"{sensor}/{name}/info/camera_info", fx=fx)
            bag.image(f"{sensor}/{name}/image/data", time_ns(0), ramp(int(fx)), "mono16")
    dataset = registry.open_dataset(path)
    assert dataset.intrinsics.fx == 40
    np.testing.assert_array_equal(dataset.frame(0).depth, ramp(40))


def test_a_camera_of_the_same_frame_will_do(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera("/x/info", fx=40)
        bag.camera("/y/info", fx=50, frame="other")
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
    assert registry.open_dataset(path).intrinsics.fx == 40


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
    said = refusal("bag", path)
    assert "found camera_info topics: none, expected one beside /depth; give --set" in said
    (tmp_path / "b").mkdir()
    with writing(tmp_path / "b", "mcap") as (bag, path):
        bag.camera("/camera_info", size=(64, 48))
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
        bag.image("/color", time_ns(0), ramp(), "rgb8")
    assert "found a camera of 64x48 pixels, expected 32x24 as /depth" in refusal("bag", path)
    assert "found no images on /x, expected one of: /color, /depth" in refusal(
        "bag", path, topic="/x"
    )
    (tmp_path / "c").mkdir()
    with writing(tmp_path / "c", "ros1") as (bag, path):
        bag.camera("/camera_info", fx=0)
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
    assert "/camera_info: found no focal length" in refusal("bag", path)
    (tmp_path / "d").mkdir()
    with writing(tmp_path / "d", "ros1") as (bag, path):
        bag.image("/color", time_ns(0), ramp(), "rgb8")
    assert "found no depth images (of images: /color (rgb8)), expected a topic" in refusal(
        "bag", path
    )


def test_one_bad_image_is_told_when_it_is_read(tmp_path: Path) -> None:
    with writing(tmp_path, "ros1") as (bag, path):
        bag.camera(INFO)
        for number in range(4):
            image = ramp()[:12] if number == 1 else ramp(number)
            bag.image(TOPIC, time_ns(number), image, "rgb8" if number == 2 else "16UC1")
    dataset = registry.open_dataset(path)
    with pytest.raises(DatasetError, match=r"image 1: found 32x12 pixels, expected 32x24"):
        dataset.frame(1)
    with pytest.raises(
        DatasetError, match=r"toy\.bag: /camera.*image 2: found images coded as rgb8"
    ):
        dataset.frame(2)
    np.testing.assert_array_equal(dataset.frame(3).depth, ramp(3))


@pytest.mark.parametrize("form", FORMATS)
def test_times_without_stamps_are_those_of_reception(
    tmp_path: Path, form: str, caplog: pytest.LogCaptureFixture
) -> None:
    dataset = registry.open_dataset(write(tmp_path, form, stamp_ns=0))
    assert dataset.frame(1).stamp_s == pytest.approx((time_ns(1) + 5_000_000) * 1e-9, abs=1e-6)
    assert "stamps do not grow; taking times of reception" in caplog.text


@pytest.mark.parametrize("form", FORMATS)
def test_images_received_at_once_are_told_apart(tmp_path: Path, form: str) -> None:
    dataset = registry.open_dataset(write(tmp_path, form, received_ns=time_ns(9)))
    for number in (2, 0, 3, 1):
        np.testing.assert_array_equal(dataset.frame(number).depth, ramp(number))


# Poses

T_BASE_CAMERA = se3.exp(np.array([0.0, 1.2, 0.0, 0.1, -0.2, 0.3]))


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_odometry_is_carried_to_the_camera(tmp_path: Path, form: str) -> None:
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        bag.tf("/tf_static", START_NS, "base_link", "mount", np.eye(4))
        bag.tf("/tf_static", START_NS, "mount", FRAME, T_BASE_CAMERA)
        for number in range(4):
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
            bag.odometry("/odom", time_ns(number - 0.5), pose(number - 0.5), "base_link")
    dataset = registry.open_dataset(path, "bag", {"groundtruth": "/odom"})
    check_dataset(dataset)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    np.testing.assert_allclose(groundtruth.poses[1], pose(1) @ T_BASE_CAMERA, atol=1e-5)
    assert np.isnan(groundtruth.poses[3]).all(), "after the last pose"
    assert registry.open_dataset(path).groundtruth() is None


@pytest.mark.parametrize("form", ["ros1", "sqlite3"])
def test_transforms_are_composed_up_to_the_world(tmp_path: Path, form: str) -> None:
    T_map_odom = se3.exp(np.array([0.0, 0.0, 0.5, 1.0, 2.0, 0.0]))
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        bag.tf("/tf_static", START_NS, "base_link", FRAME, T_BASE_CAMERA)
        for number in range(-1, 5):
            bag.tf("/tf", time_ns(number), "odom", "base_link", pose(number))
            bag.tf("/tf", time_ns(number), "map", "odom", T_map_odom)
        for number in range(4):
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
    poses = {}
    for world in ("map", "odom"):
        options = {"groundtruth": "/tf", "world_frame": world}
        groundtruth = registry.open_dataset(path, "bag", options).groundtruth()
        assert groundtruth is not None
        poses[world] = groundtruth.poses
    np.testing.assert_allclose(poses["odom"][2], pose(2) @ T_BASE_CAMERA, atol=1e-5)
    np.testing.assert_allclose(poses["map"], T_map_odom @ poses["odom"], atol=1e-9)
    said = refusal("bag", path, groundtruth="/tf", world_frame="earth")
    assert "expected a way up to 'earth'; known frames: base_link, camera" in said
    assert "/camera/depth/camera_info: found sensor_msgs/msg/CameraInfo, expected poses: /tf" in (
        refusal("bag", path, groundtruth=INFO)
    )


# Damage


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_truncated_bags_are_refused(tmp_path: Path, form: str, share: float) -> None:
    path = write(tmp_path, form)
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    assert str(path) in refusal("bag", path)


def test_mislabelled_files_are_refused(tmp_path: Path) -> None:
    bag = write(tmp_path, "ros1")
    (mcap,) = write(tmp_path, "mcap").glob("*.mcap")
    wrong = mcap.rename(tmp_path / "wrong.bag")
    assert "found an MCAP file, expected a ROS 1 bag, as its name says" in refusal("bag", wrong)
    text = tmp_path / "text.bag"
    text.write_text("no bag")
    assert "text.bag: found something else, expected a ROS 1 bag" in refusal("bag", text)
    assert "found no bag, expected one .bag, .mcap or .db3 file" in refusal("bag", tmp_path)
    assert "found a ROS 1 bag, expected an MCAP file" in refusal(
        "bag", bag.rename(tmp_path / "wrong.mcap")
    )


def test_an_empty_bag_is_refused(tmp_path: Path) -> None:
    with writing(tmp_path, "ros1") as (_, path):
        pass
    assert "toy.bag: found " in refusal("bag", path)


def test_damaged_rvl_is_refused() -> None:
    from slam_bof_plugins.bag_images import COMPRESSED, decode_depth

    whole = bytes(12) + rvl(holes())
    sizes = [bytes(12), whole[:14], whole[:60], bytes(12) + struct.pack("<2i", -4, 9) + whole[20:]]
    for data in [*sizes, whole[:-8], bytes(12) + struct.pack("<2i", 9999, 9999)]:
        message = SimpleNamespace(data=data, format="16UC1; compressedDepth rvl")
        with pytest.raises(DatasetError, match=r"x\.bag: found RVL of "):
            decode_depth(message, COMPRESSED, "x.bag")
