"""An atlas on disk: the constellations of the keyframes of many maps, in segments.

Like a log-structured merge tree (O'Neil et al. 1996): a map becomes a small segment, and segments
of about one size are merged, so that n maps are in some log n segments. Files that are written are
never changed, and the manifest names those that count.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.atlas.keyframes import DescribedKeyframes, describe_map
from slam_bof.atlas.manifest import (
    FILE,
    AtlasMap,
    Manifest,
    SegmentEntry,
    read_manifest,
    write_manifest,
)
from slam_bof.atlas.segment import (
    Segment,
    load_segment,
    make_segment,
    merge_segments,
    save_segment,
)
from slam_bof.bof import Constellation, IndexParams, Motions, camera_motions
from slam_bof.core import lock_file, naming, one_blas_thread
from slam_bof.errors import AtlasError
from slam_bof.types import Array, Params, Pose

__all__ = ["Atlas", "AtlasMatch", "AtlasParams"]

MERGE_RATIO = 4
"""A segment is merged with the one before it, unless that is at least this many times as large."""
N_TRIES = 5
"""Times that an atlas is read again because another program has changed it meanwhile."""
LOCK = "lock"


class AtlasParams(Params):
    """How keyframes are looked up in an atlas."""

    n_compared: int = Field(
        100,
        gt=0,
        description="Number of keyframes with most votes that are matched contour by contour.",
    )
    max_votes: int = Field(
        600_000,
        gt=0,
        description="Largest number of votes that are counted for a query, over all segments.",
    )


@dataclass(frozen=True, slots=True, eq=False)
class AtlasMatch:
    """A keyframe that agrees with a query: its map, its id there, and the pose by its contours."""

    map: AtlasMap
    keyframe_id: int
    score: float
    T_match_query: Pose


class Atlas:
    """One state of an atlas, for reading; ``add`` and ``remove`` make the next one.

    Any number of programs may read while one writes: they go on with the state that they opened.

    Examples
    --------
    >>> Atlas.add("fleet.atlas", ["home/map.db", "office/map.db"])  # doctest: +SKIP
    >>> Atlas.open("fleet.atlas").search(constellation, 5)[0].map.path  # doctest: +SKIP
    """

    def __init__(
        self, folder: Path, manifest: Manifest, segments: Sequence[Segment], params: AtlasParams
    ) -> None:
        self.folder, self.params, self.maps = folder, params, manifest.maps
        self._by_id = {entry.id: entry for entry in manifest.maps}
        self._segments = [segment for segment in segments if segment.maps]
        self._in_use = [np.isin(segment.map_ids, list(self._by_id)) for segment in self._segments]
        downs = [(0.0, 1.0, 0.0), *(entry.down for entry in manifest.segments)]
        self.down: Array = np.sum(downs, axis=0)

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return int(sum(in_use.sum() for in_use in self._in_use))

    @classmethod
    def open(cls, folder: Path | str, params: AtlasParams | None = None) -> Self:
        """Open an atlas; its files are mapped into memory, not read.

        Raises
        ------
        AtlasError
            If it is none, or damaged.
        """
        folder, params = Path(folder), params or AtlasParams()
        for _ in range(N_TRIES):
            manifest = read_manifest(folder)
            try:
                return cls(folder, manifest, _load(folder, manifest, params), params)
            except FileNotFoundError as error:
                missing = error.filename
        raise AtlasError(f"{missing}: found no such file, expected one that {FILE} names")

    @staticmethod
    def add(folder: Path | str, paths: Iterable[Path | str]) -> list[AtlasMap]:
        """Add finished maps to an atlas, or make one; return their entries.

        A map that the atlas has is described again in place of what was known of it. Each map is
        saved before the next is read.

        Raises
        ------
        MapError
            If a map cannot be read; those before it are in the atlas.
        AtlasError
            If the atlas is damaged, or another program writes to it.
        """
        added = []
        with _writing(Path(folder)):
            for path in paths:
                resolved = Path(os.path.realpath(path))
                added += Atlas._append(Path(folder), [(str(resolved), describe_map(resolved))])
        return added

    @staticmethod
    def add_described(
        folder: Path | str, maps: Sequence[tuple[str, DescribedKeyframes]]
    ) -> list[AtlasMap]:
        """Add maps, by path, whose keyframes are described already, in one segment."""
        with _writing(Path(folder)):
            return Atlas._append(Path(folder), maps)

    @staticmethod
    def remove(folder: Path | str, paths: Iterable[Path | str]) -> list[AtlasMap]:
        """Remove maps from an atlas; return the entries that they had.

        Raises
        ------
        AtlasError
            If one is not in the atlas; nothing is removed then.
        """
        folder = Path(folder)
        wanted = {os.path.realpath(path) for path in paths}
        with _writing(folder):
            manifest = read_manifest(folder)
            gone = [entry for entry in manifest.maps if entry.path in wanted]
            if unknown := wanted - {entry.path for entry in gone}:
                raise AtlasError(
                    f"{folder}: found no map {sorted(unknown)[0]}, expected one that "
                    "slam-bof atlas list shows"
                )
            kept = [entry for entry in manifest.maps if entry not in gone]
            with _damage_named(folder):
                _replace(folder, manifest, kept, [])
        return gone

    @staticmethod
    def _append(folder: Path, maps: Sequence[tuple[str, DescribedKeyframes]]) -> list[AtlasMap]:
        manifest, paths = read_manifest(folder), {path for path, _ in maps}
        kept = [entry for entry in manifest.maps if entry.path not in paths]
        first = manifest.n_maps_added
        added = [
            AtlasMap(id=first + k, path=path, n_keyframes=len(described.ids))
            for k, (path, described) in enumerate(maps)
        ]
        new = [make_segment(first + k, described) for k, (_, described) in enumerate(maps)]
        with _damage_named(folder):
            _replace(folder, manifest, kept + added, new)
        return added

    @one_blas_thread()
    def search(self, query: Constellation, n: int) -> list[AtlasMatch]:
        """Return the up to ``n`` keyframes that agree best with a view, best first.

        Raises
        ------
        AtlasError
            If what it reads of the files is damaged.
        """
        with _damage_named(self.folder):
            return self._search(query)[:n]

    def _search(self, query: Constellation) -> list[AtlasMatch]:
        found: list[tuple[float, int, int]] = []
        for number, (segment, in_use) in enumerate(zip(self._segments, self._in_use, strict=True)):
            allowed = None if in_use.all() else in_use
            voted = segment.index.vote(query.bofs, self.params.n_compared, allowed=allowed)
            found += [(-float(vote), number, int(view)) for view, vote in zip(*voted, strict=True)]
        matches: list[AtlasMatch] = []
        chosen = sorted(found)[: self.params.n_compared]
        for number in sorted({number for _, number, _ in chosen}):
            views = np.array([view for _, other, view in chosen if other == number], np.intp)
            matches += self._compare(query, self._segments[number], views)
        return sorted(matches, key=lambda match: -match.score)

    def _compare(
        self, query: Constellation, segment: Segment, views: NDArray[np.intp]
    ) -> Iterator[AtlasMatch]:
        """Match keyframes of a segment contour by contour."""
        found = segment.index.compare(query.bofs, views)
        motions: Motions = found.motions
        R_match = segment.R_level_camera[found.view_ids].astype(np.float64)
        T_match_query = camera_motions(motions, query.R_level_camera, R_match)
        for view, score, T in zip(found.view_ids, found.scores, T_match_query, strict=True):
            entry = self._by_id[int(segment.map_ids[view])]
            yield AtlasMatch(entry, int(segment.keyframe_ids[view]), float(score), T)


def _load(folder: Path, manifest: Manifest, params: AtlasParams) -> list[Segment]:
    """Load the segments; each counts its share of the votes."""
    total = max(1, sum(entry.n_views for entry in manifest.segments))
    # All segments look in the same slices, for their votes are compared.
    beside = IndexParams().max_views_beside
    beside *= total <= beside
    return [
        load_segment(
            folder,
            entry,
            IndexParams(
                max_views_beside=beside,
                max_votes=max(1, params.max_votes * entry.n_views // total),
            ),
        )
        for entry in manifest.segments
    ]


def _replace(
    folder: Path, manifest: Manifest, maps: Sequence[AtlasMap], new: Sequence[Segment]
) -> None:
    """Write the next state: with these maps, in the present segments and a new one.

    Segments are merged where the last is not much smaller than the one before, and rewritten where
    more than half of their keyframes are of maps that are gone.
    """
    in_use = {entry.id for entry in maps}
    kept: list[SegmentEntry] = []
    merged = list(new)
    for entry in reversed(manifest.segments):
        n_used = sum(n for id_, n in entry.maps if id_ in in_use)
        n_merged = sum(len(segment.keyframe_ids) for segment in merged)
        if 2 * n_used < entry.n_views or (merged and n_used < MERGE_RATIO * n_merged):
            merged.insert(0, load_segment(folder, entry, IndexParams()))
        else:
            kept.insert(0, entry)
    merged = [s.without({id_ for id_, _ in s.maps} - in_use) for s in merged]
    merged = [segment for segment in merged if segment.maps]
    n_made = manifest.n_segments_made
    if merged:
        whole = merge_segments(merged) if len(merged) > 1 else merged[0]
        kept.append(save_segment(folder, f"segment-{n_made:06d}", whole))
    write_manifest(
        folder,
        Manifest(
            n_segments_made=n_made + bool(merged),
            n_maps_added=max([manifest.n_maps_added, *(entry.id + 1 for entry in maps)]),
            maps=tuple(maps),
            segments=tuple(kept),
        ),
    )
    for path in folder.glob("segment-*"):
        if path.name not in {entry.name for entry in kept}:
            shutil.rmtree(path, ignore_errors=True)  # open files stay readable


@contextmanager
def _damage_named(folder: Path) -> Iterator[None]:
    """Raise ``AtlasError`` for what damaged segments lead to.

    No other program changes them meanwhile: they are open, or the folder is locked.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise AtlasError(
            f"{error.filename}: found no such file, expected one that {FILE} names"
        ) from error
    except (IndexError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise AtlasError(f"{folder}: found keyframes that are damaged ({reason})") from error


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Make the folder of an atlas if there is none, and be the only program that writes to it."""
    if not folder.exists():
        folder.mkdir(parents=True)
        write_manifest(folder, Manifest())
    read_manifest(folder)  # or it is no atlas, where nothing is written
    descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            lock_file(descriptor)
        except (BlockingIOError, PermissionError):
            raise AtlasError(f"{folder}: found another program that writes to it") from None
        with naming(folder):
            yield
    finally:
        os.close(descriptor)
