"""Single depth images and their cameras, and collections of them."""

from __future__ import annotations

import dataclasses
import json
import random
import shutil
from pathlib import Path

import cv2
import numpy as np

from fuzzing.cases import Reader, expect_frame, turn, write_image
from fuzzing.mutations import mutate_array, mutate_bytes, mutate_text
from slam_bof.core import open_dataset
from slam_bof.datasets import read_depth_image

__all__ = ["READERS"]


def prepare_images(place: Path) -> None:
    """Write one image in every format, with its camera."""
    frame = turn()[0][0]
    mm = np.rint(1000 * frame.depth_m()).astype(np.uint16)
    for suffix in ("png", "tiff"):
        cv2.imwrite(str(place / f"a.{suffix}"), mm)
    cv2.imwrite(str(place / "a.jpg"), (mm // 40).astype(np.uint8))
    np.save(place / "a.npy", frame.depth_m())
    camera = {**dataclasses.asdict(frame.intrinsics), "depth_scale": 1000.0, "depth_offset": 1.0}
    (place / "intrinsics.json").write_text(json.dumps(camera))


def mutate_image(place: Path, case: Path, rng: random.Random) -> None:
    """Change an image or its camera."""
    image = rng.choice(sorted(place.glob("a.*")))
    data, camera = image.read_bytes(), (place / "intrinsics.json").read_text()
    if rng.random() < 0.3:
        camera = mutate_text(camera, rng)
    elif image.suffix == ".npy":
        data = mutate_array(data, rng)
    else:
        data = mutate_bytes(data, rng)
    (case / image.name).write_bytes(data)
    (case / "intrinsics.json").write_bytes(camera.encode(errors="surrogateescape"))


def read_image(place: Path, case: Path) -> None:
    """Read a single depth image."""
    (image,) = case.glob("a.*")
    frame, _ = read_depth_image(image)
    expect_frame(frame)


def prepare_split(place: Path) -> None:
    """Write a SUN RGB-D collection of one image."""
    from scipy.io import savemat

    folder = place / "sun" / "SUNRGBD" / "kv1" / "a"
    frame = turn()[0][0]
    write_image(folder / "depth" / "a.png", frame)
    camera = frame.intrinsics
    K = (camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1)
    (folder / "intrinsics.txt").write_text(" ".join(map(str, K)))
    (folder / "scene.txt").write_text("kitchen")
    file = place / "sun" / "SUNRGBDtoolbox" / "traintestSUNRGBD" / "allsplit.mat"
    file.parent.mkdir(parents=True)
    names = np.array(["/n/SUNRGBD/kv1/a", "/n/SUNRGBD/kv1/b"], object)
    savemat(file, {"alltrain": names, "alltest": names[:1]})


def mutate_split(place: Path, case: Path, rng: random.Random) -> None:
    """Change the list of images, or one image's files."""
    shutil.copytree(place / "sun", case / "sun")
    file = next((case / "sun").rglob("allsplit.mat"))
    if rng.random() < 0.2:
        file = rng.choice(sorted((case / "sun" / "SUNRGBD").rglob("*.txt")))
    file.write_bytes(mutate_bytes(file.read_bytes(), rng))


def read_split(place: Path, case: Path) -> None:
    """Open the collection."""
    dataset = open_dataset(case / "sun", "sunrgbd")
    for index in range(len(dataset)):
        expect_frame(dataset.frame(index))


READERS = {
    "image": Reader(14, prepare_images, mutate_image, read_image),
    "split": Reader(0.1, prepare_split, mutate_split, read_split),
}
