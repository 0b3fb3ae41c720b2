"""Lists of labelled sequences and images in CSV, splits, and trajectories to play back."""

from __future__ import annotations

import dataclasses
import json
import random
import shutil
from pathlib import Path

import numpy as np

from fuzzing.cases import Reader, expect_frame, expect_poses, turn, write_image
from fuzzing.mutations import mutate_array, mutate_bytes, mutate_text
from slam_bof.core import registry
from slam_bof.datasets import frames_of, has_groups, read_image_table, read_label_file, read_split
from slam_bof.geometry import se3, write_kitti, write_tum
from slam_bof.types import Trajectory

__all__ = ["READERS"]


def prepare_tables(place: Path) -> None:
    """Write two labelled images, with a list in either form, and a split."""
    for k in range(2):
        write_image(place / f"{k}.png", turn()[0][k])
    camera = {**dataclasses.asdict(turn()[0][0].intrinsics), "depth_scale": 1000.0}
    (place / "intrinsics.json").write_text(json.dumps(camera))
    (place / "labels.csv").write_text("path,label\n0.png,kitchen\n1.png,office\n")
    axes = ",".join(f"R{i}{j}" for i in range(3) for j in range(3))
    rows = "".join(f"{k}.png,kitchen,room {k},1,0,0,0,1,0,0,0,1\n" for k in range(2))
    (place / "images.csv").write_text(f"file,scene,group,{axes}\n{rows}")
    (place / "TrainSplit.txt").write_text("sequence1\nsequence2\n")
    (place / "seq-01").mkdir()


def mutate_table(place: Path, case: Path, rng: random.Random) -> None:
    """Change one of the lists, in a folder with the images."""
    for name in ("0.png", "1.png", "intrinsics.json", "seq-01"):
        (case / name).symlink_to(place / name)
    name = rng.choice(("labels.csv", "images.csv", "TrainSplit.txt"))
    data = (place / name).read_bytes()
    if rng.random() < 0.7:
        data = mutate_text(data.decode(), rng).encode(errors="surrogateescape")
    else:
        data = mutate_bytes(data, rng)
    (case / name).write_bytes(data)


def read_table(place: Path, case: Path) -> None:
    """Read a list in each way, and one of the frames that it names."""
    (file,) = (file for file in case.iterdir() if not file.is_symlink())
    if file.suffix == ".txt":
        read_split(case, file.name)
        return
    frames = (
        read_image_table(file)
        if has_groups(file) or file.stem == "images"
        else frames_of(read_label_file(file))
    )
    expect_frame(frames[0].read(gray=False)[0])


def prepare_trajectories(place: Path) -> None:
    """Write ten poses in every form."""
    poses = np.array(turn()[1][:10])
    truth = Trajectory(np.arange(10) / 30, poses)
    write_tum(place / "tum.txt", truth)
    write_kitti(place / "kitti.txt", truth)
    rows = np.hstack([truth.stamps_s[:, None], poses[:, :3, 3], se3.to_quaternion(poses)])
    for name, array in {"rows": rows, "poses": poses, "flat": poses[:, :3].reshape(-1, 12)}.items():
        np.save(place / f"{name}.npy", array)


def mutate_trajectory(place: Path, case: Path, rng: random.Random) -> None:
    """Change one of the files."""
    file = rng.choice(sorted(path for path in place.iterdir() if path.is_file()))
    changed = case / shutil.copy(file, case)
    if file.suffix == ".npy":
        changed.write_bytes(mutate_array(file.read_bytes(), rng))
    else:
        changed.write_bytes(mutate_text(file.read_text(), rng).encode(errors="surrogateescape"))


def read_trajectory(place: Path, case: Path) -> None:
    """Play back a trajectory to three frames."""
    (file,) = case.iterdir()
    odometry = registry.build("odometry", "recorded", {"file": str(file)})
    poses = np.array([odometry.process(frame) for frame in turn()[0][:3]])
    expect_poses(poses)
    for T in poses:
        se3.check_rigid(T)


READERS = {
    "table": Reader(8, prepare_tables, mutate_table, read_table),
    "trajectory": Reader(9, prepare_trajectories, mutate_trajectory, read_trajectory),
}
