"""ROS bags: changed bytes, and changed messages in a whole bag."""

from __future__ import annotations

import dataclasses
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from _layouts import ODOMETRY, write_bag
from rosbags.rosbag1 import Reader as Reader1, Writer as Writer1

from fuzzing.cases import Reader, expect_frame, expect_poses, quiet, shrink, turn
from fuzzing.mutations import mutate_bytes, mutate_text
from slam_bof.core import open_dataset, registry
from slam_bof.types import Trajectory

__all__ = ["READERS"]


def prepare_bags(place: Path) -> None:
    """Write four tiny frames and their odometry in every kind of bag."""
    frames, poses = (items[:4] for items in turn())
    tiny = [dataclasses.replace(shrink(f), stamp_s=k / 30) for k, f in enumerate(frames)]
    truth = Trajectory(np.arange(4) / 30, np.array(poses))
    for storage, encoding in (("ros1", "16UC1"), ("sqlite3", "32FC1"), ("mcap", "16UC1")):
        write_bag(place / storage, tiny, truth, storage=storage, encoding=encoding)


def mutate_bag(place: Path, case: Path, rng: random.Random) -> None:
    """Change bytes of a file of a bag, its metadata, or some of its messages."""
    storage = rng.choice(("ros1", "sqlite3", "mcap"))
    bag = case / storage
    shutil.copytree(place / storage, bag)
    kind = rng.random()
    if kind < 0.3 and storage == "sqlite3":
        change_rows(next(bag.glob("*.db3")), rng)
    elif kind < 0.6 and storage == "ros1":
        change_messages(next(bag.glob("*.bag")), rng)
    elif kind < 0.75 and storage != "ros1":
        file = bag / "metadata.yaml"
        file.write_bytes(mutate_text(file.read_text(), rng).encode(errors="surrogateescape"))
    else:
        file = next(file for file in bag.iterdir() if file.name != "metadata.yaml")
        file.write_bytes(mutate_bytes(file.read_bytes(), rng))
        if rng.random() < 0.3:
            (bag / "metadata.yaml").unlink(missing_ok=True)


def change_rows(file: Path, rng: random.Random) -> None:
    """Change a message, or a time, of a ROS 2 database."""
    with closing(sqlite3.connect(file)) as db:
        rows = db.execute("SELECT id, data FROM messages").fetchall()
        for number, data in rng.sample(rows, rng.choice((1, 2, len(rows)))):
            db.execute("UPDATE messages SET data = ? WHERE id = ?", (change(data, rng), number))
        if rng.random() < 0.2:
            time: Any = rng.choice((0, -1, 2**62, 1.5, "x", None))
            db.execute("UPDATE OR IGNORE messages SET timestamp = ? WHERE id % 3 = 1", (time,))
        db.commit()


def change_messages(file: Path, rng: random.Random) -> None:
    """Change messages of a ROS 1 bag, and write its index anew."""
    old = file.rename(file.with_suffix(".old"))
    with Reader1(old) as reader, Writer1(file) as writer:
        messages = list(reader.messages())
        chosen = set(rng.sample(range(len(messages)), rng.choice((1, 2, len(messages)))))
        topics = {
            c.topic: writer.add_connection(
                c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest
            )
            for c in reader.connections
        }
        for number, (connection, time_ns, data) in enumerate(messages):
            if number in chosen:
                data = change(data, rng)
                time_ns = rng.choice((time_ns, time_ns, 0, 2**31 * 10**9))
            writer.write(topics[connection.topic], time_ns, data)
    old.unlink()


def change(data: bytes, rng: random.Random) -> bytes:
    """Change a message, most likely where its fields are and not where its pixels are."""
    head = bytes(data[:120])
    if rng.random() < 0.7:
        return mutate_bytes(head, rng) + data[120:]
    return mutate_bytes(data, rng)


def read_bag(place: Path, case: Path) -> None:
    """Play back the odometry of a bag, and read its images and true poses."""
    (bag,) = case.iterdir()
    quiet(lambda: play_back(bag))
    quiet(lambda: read_frames(bag, {}))
    read_frames(bag, {"groundtruth": ODOMETRY, "world_frame": "odom"})


def play_back(bag: Path) -> None:
    """Ask recorded odometry for a pose."""
    odometry = registry.build("odometry", "recorded", {"file": str(bag), "topic": ODOMETRY})
    expect_poses(odometry.process(turn()[0][0])[None])


def read_frames(bag: Path, options: dict[str, Any]) -> None:
    """Open a bag and read all of it."""
    dataset = open_dataset(bag, "bag", options)
    truth = dataset.groundtruth()
    if truth is not None:
        expect_poses(truth.poses)
    for index in range(len(dataset)):
        frame = quiet(lambda index=index: dataset.frame(index))
        if (
            frame is not None and np.median(frame.depth_m()) < 1000.0
        ):  # else a run warns of its unit
            expect_frame(frame)


READERS = {"bag": Reader(1.5, prepare_bags, mutate_bag, read_bag)}
