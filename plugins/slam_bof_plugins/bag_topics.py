"""The topic of a bag that has depth images, found by the encoding of its images."""

from __future__ import annotations

import math

from slam_bof.errors import DatasetError
from slam_bof_plugins.bag_file import BagFile, Topic
from slam_bof_plugins.bag_images import COMPRESSED, IMAGE, encoding

__all__ = ["OPTION", "find_depth_topic", "stated_units"]

OPTION = "--set dataset.options"


def find_depth_topic(bag: BagFile, wanted: str | None = None) -> Topic:
    """Return the topic of depth images that is wanted, or the only one.

    Raises
    ------
    DatasetError
        If there is no such topic, or several and none was chosen.
    """
    images = [item for item in bag.topics if item.msgtype in (IMAGE, COMPRESSED)]
    if wanted is not None:
        for item in images:
            if item.name == wanted and item.n_messages:
                return item
        listed = ", ".join(item.name for item in images) or "none"
        raise DatasetError(f"{bag.path}: found no images on {wanted}, expected one of: {listed}")
    coded = {item.name: _encoding(bag, item) for item in images}
    depth = {item.name: item for item in images if _is_depth(item.name, coded[item.name])}
    # The same images, raw and compressed, are no choice.
    depth = {name: item for name, item in depth.items() if name.rpartition("/")[0] not in depth}
    if len(depth) == 1:
        return next(iter(depth.values()))
    listed = ", ".join(f"{name} ({coded[name] or 'empty'})" for name in (depth or coded))
    if depth:
        first = next(iter(depth))
        raise DatasetError(
            f"{bag.path}: found {len(depth)} depth topics: {listed}, "
            f"expected one; choose by {OPTION}.topic={first}"
        )
    raise DatasetError(
        f"{bag.path}: found no depth images (of images: {listed or 'none'}), "
        "expected a topic of 16UC1 or 32FC1, raw or compressedDepth"
    )


def stated_units(bag: BagFile, topic: Topic) -> float | None:
    """Return the units of depth per metre that a RealSense bag states for its sensor, if any.

    ``/device_0/sensor_0/option/Depth Units/value`` holds the metres per unit as a float32.
    """
    sensor = topic.name.split("/Depth_")[0]
    for spelling in ("Depth Units", "Depth_Units"):
        name = f"{sensor}/option/{spelling}/value"
        if name in {item.name for item in bag.topics}:
            unit_m = float(bag.first(name).data)
            if not 0.0 < unit_m < math.inf:
                raise DatasetError(f"{bag.path}: {name}: found {unit_m}, expected metres per unit")
            units = 1.0 / unit_m
            return float(round(units)) if abs(units - round(units)) < 1e-4 * units else units
    return None


def _encoding(bag: BagFile, topic: Topic) -> str:
    first = bag.first(topic.name) if topic.n_messages else None
    return "" if first is None else encoding(first, topic.msgtype)


def _is_depth(name: str, coded: str) -> bool:
    """Tell depth from infrared images, which have 16 bits too."""
    kind = coded.split(";")[0]
    if kind == "mono16":  # of the RealSense viewer
        return "depth" in name.lower()
    return kind in ("16UC1", "32FC1") and "jpeg" not in coded
