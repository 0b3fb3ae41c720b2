"""Sequences in every layout."""

from __future__ import annotations

import dataclasses
import random
import shutil
from pathlib import Path

import numpy as np
from _layouts import write_folder, write_replica, write_scannet, write_tum_layout

from fuzzing.cases import Reader, expect_frame, expect_poses, quiet, turn, write_image
from fuzzing.mutations import mutate_array, mutate_bytes, mutate_text
from slam_bof.core import open_dataset
from slam_bof.geometry import read_kitti, read_tum
from slam_bof.types import Trajectory

__all__ = ["READERS"]


def prepare_sequences(place: Path) -> None:
    """Write four frames in every layout."""
    frames, poses = (items[:4] for items in turn())
    frames = [dataclasses.replace(frame, stamp_s=k / 30) for k, frame in enumerate(frames)]
    truth = Trajectory(np.arange(4) / 30, np.array(poses))
    write_folder(place / "folder", frames, truth)
    (place / "folder" / "timestamps.txt").write_text("".join(f"{k / 30}\n" for k in range(4)))
    write_replica(place / "replica", frames, truth)
    write_scannet(place / "scannet", frames, truth)
    write_tum_layout(place / "rgbd_dataset_freiburg3_x", frames, truth)
    arrays = place / "arrays"
    (arrays / "depth").mkdir(parents=True)
    shutil.copy(place / "folder" / "intrinsics.json", arrays)
    for k, frame in enumerate(frames):
        kind = np.float32 if k % 2 else np.float64
        np.save(arrays / "depth" / f"{k}.npy", frame.depth_m().astype(kind))
    scenes = place / "7scenes" / "kitchen" / "seq-01"
    for k, (frame, T) in enumerate(zip(frames, poses, strict=True)):
        write_image(scenes / f"frame-{k:06d}.depth.png", frame)
        np.savetxt(scenes / f"frame-{k:06d}.pose.txt", T)
    labels = "".join(f"{k},kitchen\n" for k in range(4))
    (scenes / "scenes.csv").write_text(f"frame,scene\n{labels}")


def mutate_sequence(place: Path, case: Path, rng: random.Random) -> None:
    """Change one file of a sequence."""
    chosen = rng.choice(sorted(path for path in place.iterdir() if path.name != "case"))
    shutil.copytree(chosen, case / chosen.name)
    files = sorted(path for path in (case / chosen.name).rglob("*") if path.is_file())
    texts = [path for path in files if path.suffix in (".txt", ".json", ".sens", ".npy", ".csv")]
    file = rng.choice(texts if texts and rng.random() < 0.75 else files)
    if file.suffix in (".txt", ".json", ".csv"):
        text = mutate_text(file.read_text(), rng)
        file.write_bytes(text.encode(errors="surrogateescape"))
    elif file.suffix == ".npy":
        file.write_bytes(mutate_array(file.read_bytes(), rng))
    else:
        file.write_bytes(mutate_bytes(file.read_bytes(), rng))


def read_sequence(place: Path, case: Path) -> None:
    """Open a sequence and read all of it."""
    (folder,) = case.iterdir()
    for file in folder.glob("*.txt"):
        for read in (read_tum, read_kitti):
            trajectory = quiet(lambda read=read, file=file: read(file))
            if trajectory is not None:
                expect_poses(trajectory.poses)
    if next(folder.rglob("frame-*.depth.png"), None):
        folder = folder / "kitchen" / "seq-01" if (folder / "kitchen").is_dir() else folder
    dataset = open_dataset(folder)
    dataset.scenes()
    groundtruth = dataset.groundtruth()
    if groundtruth is not None:
        expect_poses(groundtruth.poses)
    for index in range(len(dataset)):
        frame = quiet(lambda index=index: dataset.frame(index))
        if frame is not None:
            expect_frame(frame)


READERS = {"sequence": Reader(14, prepare_sequences, mutate_sequence, read_sequence)}
