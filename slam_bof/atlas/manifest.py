"""The manifest of an atlas: which maps it has, and in which segments their keyframes are.

It is replaced as a whole, by a rename, so that a reader or a power cut finds the old one or the
new one. Segments are never changed: a manifest that names one is written after it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from slam_bof.core import describe_error, open_bytes
from slam_bof.errors import AtlasError

__all__ = ["AtlasMap", "Manifest", "SegmentEntry", "read_manifest", "sync", "write_manifest"]

FILE = "atlas.json"
MAX_BYTES = 64_000_000
SEGMENT = r"^segment-\d{6,12}$"
Count = Annotated[int, Field(ge=0, lt=10**12)]


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class AtlasMap(_Entry):
    """A map of the atlas: its number, its ``map.db``, and how many keyframes are in the atlas."""

    id: Count
    path: str = Field(min_length=1, max_length=4096)
    n_keyframes: Count


class SegmentEntry(_Entry):
    """A segment: its folder, and the numbers of its maps with that of keyframes of each, in order.

    ``down`` is the sum of the directions of gravity in the camera frames of all its keyframes.
    """

    name: str = Field(pattern=SEGMENT)
    maps: tuple[tuple[Count, Count], ...] = Field(strict=False)
    down: tuple[float, float, float] = Field(strict=False)

    @property
    def n_views(self) -> int:
        """Number of keyframes."""
        return sum(n for _, n in self.maps)


class Manifest(_Entry):
    """What an atlas consists of."""

    version: Literal[1] = 1
    n_segments_made: Count = 0
    n_maps_added: Count = 0
    maps: tuple[AtlasMap, ...] = Field(default=(), strict=False)
    segments: tuple[SegmentEntry, ...] = Field(default=(), strict=False)

    @model_validator(mode="after")
    def _check_names(self) -> Manifest:
        if len({segment.name for segment in self.segments}) < len(self.segments):
            raise ValueError("segments must have different names")
        return self


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of an atlas.

    Raises
    ------
    AtlasError
        If there is none, or it is damaged.
    """
    path = folder / FILE
    try:
        with open_bytes(path) as file:
            text = file.read(MAX_BYTES + 1)
    except (FileNotFoundError, NotADirectoryError):
        raise AtlasError(
            f"{folder}: found no atlas, expected a folder with {FILE}; slam-bof atlas add makes one"
        ) from None
    except OSError as error:
        raise AtlasError(f"{path}: cannot be read: {error.strerror}") from error
    if len(text) > MAX_BYTES:
        raise AtlasError(f"{path}: found more than {MAX_BYTES} bytes, expected fewer")
    try:
        return Manifest.model_validate_json(text)
    except ValidationError as error:
        raise AtlasError(f"{path}: {describe_error(error, Manifest)}") from error


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Replace the manifest, once the new one is on the disk."""
    unfinished = folder / f"{FILE}.new"
    unfinished.write_text(manifest.model_dump_json(indent=1))
    sync(unfinished)
    os.replace(unfinished, folder / FILE)
    sync(folder)


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name == "nt":
        return  # which cannot open folders
    descriptor = os.open(path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
