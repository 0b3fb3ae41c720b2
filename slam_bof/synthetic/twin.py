"""A synthetic room built around a real camera trajectory: its twin.

The hand-held motion is real, and the room is synthetic. Its furniture stands where the cameras
look, but never where they are.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from slam_bof.core import read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.synthetic import furniture as f
from slam_bof.synthetic.furnisher import Furnisher
from slam_bof.synthetic.furniture import Maker
from slam_bof.synthetic.meshes import Mesh, merge
from slam_bof.synthetic.walls import Opening, shell
from slam_bof.synthetic.writer import Progress, write_scene
from slam_bof.types import Array, Pose

__all__ = ["gravity_aligned", "make_twin_room", "read_poses", "write_twin"]

_LINE = re.compile(r"(?P<sequence>seq-\d+)/frame-(?P<number>\d+)\S*\s+(?P<values>.+)")
_CAMERA_CLEARANCE_M = 0.6
_FLOOR_BELOW_M = 1.2
_GENERATION = 1


def read_poses(files: list[Path], sequence: str) -> tuple[list[int], Array]:
    """Read a sequence's poses from pseudo ground-truth files (Brachmann et al. 2021).

    Parameters
    ----------
    files
        Lines ``seq-XX/frame-N... qw qx qy qz tx ty tz f``, world-to-camera.
    sequence
        Name of the sequence, such as ``seq-03``.

    Returns
    -------
    numbers, poses
        Frame numbers in order, and ``T_world_camera`` (N, 4, 4).

    Raises
    ------
    DatasetError
        If a file or a line cannot be read, or the sequence is in none of them.
    """
    rows: dict[int, Array] = {}
    for file in files:
        try:
            lines = read_text(file, "replace").splitlines()
        except OSError as error:
            raise DatasetError(f"{file}: found {error.strerror}, expected poses") from error
        for line in lines:
            match = _LINE.fullmatch(line.strip())
            values = match["values"].split() if match else []
            if match is None or len(values) != 8:
                raise DatasetError(
                    f"{file}: found {line[:80]!r}, expected seq-XX/frame-N and 8 numbers"
                )
            if match["sequence"] == sequence:
                rows[int(match["number"])] = np.array(values[:7], dtype=np.float64)
    if not rows:
        names = ", ".join(str(file) for file in files)
        raise DatasetError(f"{names}: found no frame of {sequence}, expected some")
    numbers = sorted(rows)
    table = np.array([rows[number] for number in numbers])
    return numbers, se3.inverse(se3.from_quaternion(table[:, [1, 2, 3, 0]], table[:, 4:]))


def gravity_aligned(poses: Array) -> Array:
    """Rotate the world so that z is up and the cameras look along +y on average.

    The x axis of a hand-held camera is about level. Up is therefore the direction with the smallest
    components of the x axes, on the side opposite the mean y axis.

    Parameters
    ----------
    poses
        ``T_world_camera`` (N, 4, 4).

    Returns
    -------
    Array
        The same poses in the turned world (N, 4, 4).
    """
    level = poses[:, :3, 0]
    up = np.linalg.eigh(level.T @ level)[1][:, 0]
    up = up * -np.sign(up @ poses[:, :3, 1].mean(axis=0))
    ahead = poses[:, :3, 2].mean(axis=0)
    ahead = ahead - (ahead @ up) * up
    ahead = ahead / np.linalg.norm(ahead)
    return np.asarray(se3.pose(np.stack([np.cross(ahead, up), ahead, up]), np.zeros(3)) @ poses)


def make_twin_room(poses: Array, *, seed: int = 0) -> Mesh:
    """Build a furnished room around a trajectory.

    Parameters
    ----------
    poses
        ``T_world_camera`` (N, 4, 4), z up.
    seed
        Seed of the furniture.

    Returns
    -------
    Mesh
        The room in the world frame of the poses. Its floor is 1.2 m below the lowest camera, and no
        furniture is within 0.6 m of a camera.
    """
    rng = np.random.default_rng([seed, 23])
    position, ahead = poses[:, :3, 3], poses[:, :3, 2]
    looked_at = (position + 2.2 * ahead)[:, :2]
    reach = 1.1
    low = np.minimum(position[:, :2].min(axis=0) - reach, looked_at.min(axis=0) - 0.5)
    high = np.maximum(position[:, :2].max(axis=0) + reach, looked_at.max(axis=0) + 0.5)
    floor = position[:, 2].min() - _FLOOR_BELOW_M
    height = max(position[:, 2].max() + 0.7 - floor, 2.5)
    width, depth = high - low

    openings = [
        Opening(0, width / 2, 0.9, 0.0, 2.05, "door"),
        Opening(1, depth * 0.4, 1.4, 0.9, 2.2, "window"),
        Opening(2, width * 0.7, 1.2, 0.9, 2.2, "window"),
    ]
    eye = position - (*low, floor)
    # Low pieces may stand below a camera, so that it does not see a bare floor.
    below = eye[:, 2] - _CAMERA_CLEARANCE_M
    clear = np.column_stack([eye[:, :2], below, np.full(len(poses), _CAMERA_CLEARANCE_M)])
    placer = Furnisher(width, depth, openings, clear, rng)
    to_floor = (eye[:, 2] - 0.3) / np.maximum(-ahead[:, 2], 1e-3)
    for maker in _IN_VIEW * 3:
        for _ in range(6):
            i = rng.integers(len(poses))
            x, y = eye[i, :2] + min(rng.uniform(1.3, 2.4), to_floor[i]) * ahead[i, :2]
            if placer.near(maker, x, y):
                break
    for maker in _AT_WALLS:
        placer.against_wall(maker, n=2)
    room = merge([shell(width, depth, height, openings, rng), *placer.meshes])
    return room.placed(low[0], low[1], floor)


_IN_VIEW: tuple[Maker, ...] = (
    f.dining_set,
    f.desk,
    f.sofa,
    f.coffee_table,
    f.armchair,
    f.cabinet,
    f.boxes,
    f.boxes,
    f.plant,
    f.coffee_table,
    f.office_chair,
    f.chair,
    f.boxes,
)
_AT_WALLS: tuple[Maker, ...] = (
    f.bookshelf,
    f.whiteboard,
    f.tv_stand,
    f.cabinet,
    f.wall_shelf,
    f.wall_cabinet,
    f.picture,
    f.radiator,
    f.boxes,
    f.sconce,
    f.wall_shelf,
    f.wall_cabinet,
)


def write_twin(
    folder: Path,
    files: list[Path],
    *,
    sequence: str = "seq-03",
    name: str = "chess-twin",
    seed: int = 0,
    n_frames: int | None = None,
    progress: Progress | None = None,
) -> tuple[Path, int]:
    """Write ``folder/name/sequence`` in 7-Scenes layout, unless it exists.

    Parameters
    ----------
    folder
        Parent of the scene folder.
    files, sequence
        Files of the poses; see ``read_poses``.
    name
        Name of the scene folder.
    seed
        Seed of furniture and sensor noise.
    n_frames
        Number of frames from the start, by default all.
    progress
        Called after each frame.

    Returns
    -------
    sequence_folder, n_missing
        Folder of the frames, and the number of missing frames between the first and the last.

    Raises
    ------
    DatasetError
        In the cases of ``read_poses``, or if the folder exists with other content or the twin of
        another sequence.
    """
    numbers, given = read_poses(files, sequence)
    poses: Pose = gravity_aligned(given)
    room = make_twin_room(poses, seed=seed)
    numbers, poses = numbers[:n_frames], poses[:n_frames]
    recipe: dict[str, object] = {
        "generation": _GENERATION,
        "kind": f"{name}/{sequence}",
        "poses": [file.parent.name + "/" + file.name for file in files],
        "seed": seed,
        "n_frames": len(poses),
    }
    target = folder / name
    for other in sorted(target.glob("seq-*")):
        if other.name != sequence:
            # Each sequence has a room of its own, and a scene folder holds one room.
            raise DatasetError(
                f"{target}: found the twin of {other.name}, expected none or that of {sequence}; "
                "choose another folder"
            )
    written = write_scene(
        target,
        sequence,
        room,
        poses,
        recipe=recipe,
        frame_numbers=numbers,
        seed=seed,
        progress=progress,
    )
    return written, numbers[-1] - numbers[0] + 1 - len(numbers)
