"""A segment of an atlas: the keyframes of some maps in files that are never changed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.atlas.keyframes import DescribedKeyframes
from slam_bof.atlas.manifest import SegmentEntry, sync
from slam_bof.bof import ConstellationIndex, IndexParams
from slam_bof.core import open_npy
from slam_bof.errors import AtlasError

__all__ = ["Segment", "load_segment", "make_segment", "merge_segments", "save_segment"]


@dataclass(frozen=True, eq=False)
class Segment:
    """Keyframes of some maps, one map after another.

    Parameters
    ----------
    maps
        Number of each map, and how many of the keyframes are its own.
    index
        Their constellations.
    keyframe_ids
        (V,) in their maps.
    R_level_camera
        (V, 3, 3) of ``bof.Constellation``.
    """

    maps: tuple[tuple[int, int], ...]
    index: ConstellationIndex
    keyframe_ids: NDArray[np.int32]
    R_level_camera: NDArray[np.float32]

    @cached_property
    def map_ids(self) -> NDArray[np.int64]:
        """The number (V,) of each keyframe's map."""
        ids, counts = np.array(self.maps, np.int64).reshape(-1, 2).T
        return np.repeat(ids, counts)

    def without(self, maps: set[int]) -> Segment:
        """Return the segment without some maps."""
        if not maps.intersection(id_ for id_, _ in self.maps):
            return self
        is_kept = ~np.isin(self.map_ids, list(maps))
        self.index.keep(is_kept)
        left = tuple((id_, n) for id_, n in self.maps if id_ not in maps)
        return Segment(left, self.index, self.keyframe_ids[is_kept], self.R_level_camera[is_kept])


def make_segment(map_id: int, keyframes: DescribedKeyframes) -> Segment:
    """Return a segment of one map."""
    maps = ((map_id, len(keyframes.ids)),)
    return Segment(maps, keyframes.index, keyframes.ids, keyframes.R_level_camera)


def merge_segments(segments: list[Segment]) -> Segment:
    """Return one segment with the keyframes of several."""
    return Segment(
        tuple(pair for segment in segments for pair in segment.maps),
        ConstellationIndex.joined([segment.index for segment in segments]),
        np.concatenate([segment.keyframe_ids for segment in segments]),
        np.concatenate([segment.R_level_camera for segment in segments]),
    )


def save_segment(atlas: Path, name: str, segment: Segment) -> SegmentEntry:
    """Write a segment into a new folder of the atlas, all of it to the disk."""
    folder = atlas / name
    shutil.rmtree(folder, ignore_errors=True)  # what a killed program has left
    folder.mkdir()
    columns = segment.index.columns()
    columns |= {"keyframe_ids": segment.keyframe_ids, "R_level_camera": segment.R_level_camera}
    for column, array in columns.items():
        path = folder / f"{column}.npy"
        np.save(path, array)
        sync(path)
    sync(folder)
    sync(atlas)
    x, y, z = segment.R_level_camera[:, 1].sum(axis=0, dtype=np.float64).tolist()
    return SegmentEntry(name=name, maps=segment.maps, down=(x, y, z))


def load_segment(atlas: Path, entry: SegmentEntry, params: IndexParams) -> Segment:
    """Map the files of a segment into memory.

    Raises
    ------
    FileNotFoundError
        If there are none: another program has merged the segment meanwhile.
    AtlasError
        If they are damaged.
    """
    folder, n = atlas / entry.name, entry.n_views
    columns: dict[str, NDArray[Any]] = {}
    for column, like in ConstellationIndex(params).columns().items():
        columns[column] = _open(folder, column, like.dtype, like.shape[1:])
    ids = _open(folder, "keyframe_ids", np.dtype(np.int32), ())
    R_level_camera = _open(folder, "R_level_camera", np.dtype(np.float32), (3, 3))
    lengths = {len(columns["starts"]) - 1, len(columns["totals"]), len(ids), len(R_level_camera)}
    starts, n_rows = columns["starts"], len(columns["rows"])
    is_whole = lengths == {n} and starts[0] == 0 and starts[-1] == n_rows
    is_whole = is_whole and bool((np.diff(starts) >= 0).all())
    names = ("keys", "views", "places", "phases")
    if not is_whole or any(len(columns[name]) != n_rows for name in names):
        raise AtlasError(f"{folder}: found columns of other lengths, expected {n} keyframes")
    return Segment(entry.maps, ConstellationIndex.load(columns, params), ids, R_level_camera)


def _open(folder: Path, column: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    path = folder / f"{column}.npy"
    try:
        array = open_npy(path)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise AtlasError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise AtlasError(f"{path}: {error}") from error
    if array.dtype != dtype or array.shape[1:] != shape or not array.ndim:
        raise AtlasError(
            f"{path}: found an array {array.shape} of {array.dtype}, expected {dtype} "
            f"of {('n', *shape)}"
        )
    return array
