#!/usr/bin/env python3
"""Close loops live: frames from one process, poses from another, late and out of order.

    scripts/examples/live.py SEQUENCE [--max-frames 300]

The camera stands for a driver: it blocks while its queue is full, which is what to do with one
that can wait (one that cannot drops frames, and counts them). The odometry sends its poses in
bursts, shuffled, up to half a second late. ``FramePoseSynchroniser`` brings both together.
"""

from __future__ import annotations

import argparse
import multiprocessing
import queue
import random
import sys
from pathlib import Path
from typing import Any

from slam_bof import LoopCloser
from slam_bof.core import registry
from slam_bof.datasets import FramePoseSynchroniser
from slam_bof.errors import SlamBofError
from slam_bof.types import EdgeKind

MAX_LATE = 15
"""Poses that are held back and shuffled, half a second of them."""
END = None


def run_camera(path: Path, n_frames: int, frames: Any) -> None:
    dataset = registry.open_dataset(path)
    for index in range(n_frames):
        frames.put(dataset.frame(index))  # waits while the queue is full: back-pressure
    frames.put(END)


def run_odometry(path: Path, n_frames: int, name: str, poses: Any) -> None:
    dataset = registry.open_dataset(path)
    odometry = registry.build("odometry", name)
    held: list[Any] = []
    late = random.Random(0)
    for index in range(n_frames):
        frame = dataset.frame(index)
        held.append((frame.stamp_s, odometry.process(frame)))
        if len(held) == MAX_LATE or index == n_frames - 1:
            late.shuffle(held)
            for pose in held:
                poses.put(pose)
            held = []
    poses.put(END)


def close_loops(frames: Any, poses: Any) -> tuple[LoopCloser, FramePoseSynchroniser, int]:
    closer, pairing, most = LoopCloser.from_preset("indoor"), FramePoseSynchroniser(), 0
    is_open = {"frames": True, "poses": True}
    while any(is_open.values()):
        # Where it is full, poses are waited for and frames stay in their queue.
        for name, source in (("poses", poses), ("frames", frames)):
            if not is_open[name] or (name == "frames" and pairing.is_full and is_open["poses"]):
                continue
            try:
                item = source.get(timeout=0.01)
            except queue.Empty:
                continue
            if item is END:
                is_open[name] = False
            elif name == "poses":
                pairing.add_pose(*item)
            elif not pairing.add_frame(item):
                raise RuntimeError("no poses come, and there is no room for another frame")
        most = max(most, pairing.n_waiting)
        for frame, T_odom_camera in pairing.take(at_end=not any(is_open.values())):
            closer.process(frame, T_odom_camera)
    return closer, pairing, most


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", type=Path, metavar="SEQUENCE")
    parser.add_argument("--odometry", default="kiss-icp", help="kiss-icp by default")
    parser.add_argument("--max-frames", type=int, help="all by default")
    arguments = parser.parse_args()
    try:
        dataset = registry.open_dataset(arguments.sequence)
        registry.load("odometry", arguments.odometry)
    except SlamBofError as error:
        print(error, file=sys.stderr)
        return 1
    n_frames = min(len(dataset), arguments.max_frames or len(dataset))
    context = multiprocessing.get_context("spawn")
    frames, poses = context.Queue(maxsize=8), context.Queue(maxsize=256)
    camera = context.Process(target=run_camera, args=(arguments.sequence, n_frames, frames))
    odometry = context.Process(
        target=run_odometry, args=(arguments.sequence, n_frames, arguments.odometry, poses)
    )
    for process in (camera, odometry):
        process.daemon = True  # not to outlive an interrupted main process
        process.start()
    closer, pairing, most = close_loops(frames, poses)
    for process in (camera, odometry):
        process.join()
    trajectory = closer.finish()
    n_loops = sum(loop.kind == EdgeKind.LOOP for loop in closer.map.loops)
    print(
        f"{len(trajectory)} of {n_frames} frames, {len(closer.map.keyframes)} keyframes, ", end=""
    )
    print(f"{n_loops} loops; at most {most} frames waited")
    for reason, count in sorted(pairing.counts.items()):
        print(f"dropped: {count} x {reason}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
