"""Write sequences in 7-Scenes layout: depth, colour, poses, splits and room labels."""

from __future__ import annotations

import csv
import io
import json
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from slam_bof.errors import DatasetError
from slam_bof.synthetic.flat import make_flat, make_tour
from slam_bof.synthetic.meshes import Mesh
from slam_bof.synthetic.scene import Scene3D, View
from slam_bof.synthetic.sensor import SensorModelParams, sense
from slam_bof.types import Array, Pose

__all__ = ["Progress", "write_flat", "write_scene", "write_sequence"]

Progress = Callable[[int, int], None]
"""Called with the number of frames written and to be written."""

_GENERATION = 1
"""Version of the generator: files of other versions are written again."""
_RECIPE = "recipe.json"
_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


def write_flat(
    folder: Path,
    *,
    seed: int = 0,
    n_frames: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write the tour of a synthetic flat as ``folder/flat/seq-01``, unless it exists.

    Parameters
    ----------
    folder
        Parent of the scene folder ``flat``, created if missing.
    seed
        Seed of flat, tour and sensor noise. The same seed gives the same bytes.
    n_frames
        Number of frames from the start, by default all.
    progress
        Called after each frame.

    Returns
    -------
    Path
        The sequence's folder, with a ``scenes.csv`` of true room labels.

    Raises
    ------
    DatasetError
        If ``folder/flat`` exists and was not written by this function.
    """
    flat = make_flat(seed)
    poses = make_tour(flat, seed=seed)[:n_frames]
    return write_scene(
        folder / "flat",
        "seq-01",
        flat.mesh,
        poses,
        recipe={"generation": _GENERATION, "kind": "flat", "seed": seed, "n_frames": len(poses)},
        labels=[flat.kind_at(x, y) for x, y in poses[:, :2, 3]],
        seed=seed,
        progress=progress,
    )


def _is_complete(folder: Path, recipe: dict[str, object]) -> bool:
    """Return whether a scene folder is complete and was written from this recipe."""
    try:
        return bool(json.loads((folder / _RECIPE).read_text("utf-8")) == recipe)
    except (OSError, ValueError):
        return False


def write_scene(
    folder: Path,
    sequence: str,
    mesh: Mesh,
    poses: Array,
    *,
    recipe: dict[str, object],
    frame_numbers: Sequence[int] | None = None,
    labels: Sequence[str] | None = None,
    dark: Collection[int] = (),
    seed: int = 0,
    sensor: SensorModelParams | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a scene folder of one sequence completely, unless it exists.

    Parameters
    ----------
    folder, sequence
        Folder of the scene, and the name of the sequence in it, such as ``seq-01``.
    mesh, poses
        The mesh of the scene, and ``T_world_camera`` (N, 4, 4).
    recipe
        Everything that the bytes depend on. A folder written from the same recipe is kept.
    frame_numbers, dark, seed, sensor, progress
        See ``write_sequence``.
    labels
        (N,) true scene labels, for a ``scenes.csv``.

    Returns
    -------
    Path
        The sequence's folder.

    Raises
    ------
    DatasetError
        If the folder exists and is not a synthetic scene.
    """
    if _is_complete(folder, recipe):
        return folder / sequence
    if folder.exists() and not (folder / _RECIPE).is_file():
        raise DatasetError(f"{folder}: found other files, expected nothing or a synthetic scene")
    folder.parent.mkdir(parents=True, exist_ok=True)
    building = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        building.chmod(0o755)
        write_sequence(
            building / sequence,
            Scene3D(mesh),
            poses,
            frame_numbers=frame_numbers,
            dark=dark,
            seed=seed,
            sensor=sensor,
            progress=progress,
        )
        if labels is not None:
            numbers = range(len(poses)) if frame_numbers is None else frame_numbers
            _write_labels(building / sequence / "scenes.csv", numbers, labels)
        split = f"sequence{int(sequence.rsplit('-', 1)[1])}\n"
        for name in ("TrainSplit.txt", "TestSplit.txt"):
            (building / name).write_text(split, "utf-8")
        (building / _RECIPE).write_text(json.dumps(recipe) + "\n", "utf-8")
        if folder.exists():
            shutil.rmtree(folder)
        building.rename(folder)
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return folder / sequence


def write_sequence(
    folder: Path,
    scene: Scene3D,
    poses: Array,
    *,
    frame_numbers: Sequence[int] | None = None,
    dark: Collection[int] = (),
    seed: int = 0,
    sensor: SensorModelParams | None = None,
    progress: Progress | None = None,
) -> None:
    """Render a scene from each pose and write the frames into a folder.

    Parameters
    ----------
    folder
        Folder, created if missing, of ``frame-NNNNNN.{depth.png,color.png,pose.txt}``.
    scene
        The scene.
    poses
        ``T_world_camera`` (N, 4, 4).
    frame_numbers
        Numbers in the names of the files, by default 0 to N - 1.
    dark
        Numbers of frames in which the lens is covered.
    seed
        Seed of the sensor noise, which depends on it and the number of the frame only.
    sensor
        Parameters of the depth camera.
    progress
        Called after each frame.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = list(range(len(poses)) if frame_numbers is None else frame_numbers)
    pending: deque[Future[None]] = deque()
    # Ray casting and PNG coding both release the interpreter, so one thread each runs in parallel.
    with ThreadPoolExecutor(max_workers=1) as pool:
        for done, (number, pose) in enumerate(zip(numbers, poses, strict=True), start=1):
            view = None if number in dark else scene.view(pose)
            pending.append(
                pool.submit(_write_frame, folder, number, scene, view, pose, seed, sensor)
            )
            while len(pending) > 3:
                pending.popleft().result()
            if progress is not None:
                progress(done, len(numbers))
        while pending:
            pending.popleft().result()


def _write_frame(
    folder: Path,
    number: int,
    scene: Scene3D,
    view: View | None,
    T_world_camera: Pose,
    seed: int,
    sensor: SensorModelParams | None,
) -> None:
    shape = scene.intrinsics.height, scene.intrinsics.width
    depth, color = np.zeros(shape, np.uint16), np.zeros((*shape, 3), np.uint8)
    if view is not None:
        rng = np.random.default_rng([seed, number])
        depth = sense(view.depth_m, view.returned, rng, sensor)
        color = scene.color(view)[..., ::-1]
    stem = f"frame-{number:06d}"
    for name, image in ((f"{stem}.depth.png", depth), (f"{stem}.color.png", color)):
        path = folder / name
        coded, data = cv2.imencode(".png", image, _FAST_PNG)
        if not coded:
            raise OSError(f"{path}: could not be coded as PNG")
        path.write_bytes(data.tobytes())
    text = io.StringIO()
    np.savetxt(text, T_world_camera, fmt="%.9e", delimiter="\t")
    (folder / f"{stem}.pose.txt").write_text(text.getvalue(), "utf-8")


def _write_labels(path: Path, numbers: Sequence[int], labels: Sequence[str]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("frame", "scene"))
        table.writerows(zip(numbers, labels, strict=True))
