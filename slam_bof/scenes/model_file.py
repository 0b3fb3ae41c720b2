"""The format of a model file: a zip of a manifest and of entries, with a hash of all content.

``manifest.json`` has the format version, the parameters, what the model was trained on, and the
SHA-256 of all the content. What is in the other entries is up to ``Model``; arrays are ``.npy``
files. Nothing is pickled, and the same content gives the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import lzma
import os
import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import parse_npy, read_bytes
from slam_bof.errors import ModelError
from slam_bof.scenes.stored_classifier import Entries, read_entries, zip_entries

__all__ = [
    "FORMAT_VERSION",
    "ModelContent",
    "array_bytes",
    "parse_array",
    "parse_arrays",
    "parse_content",
    "read_content",
    "stated_hash",
    "write_content",
]

FORMAT = "slam_bof model"
FORMAT_VERSION = 1
UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    RuntimeError,  # a password, an unknown compression, endless nesting
    OverflowError,
    OSError,  # a damaged bzip2 stream
)
"""What the libraries raise for files that are no models."""
MAX_WEIGHT = 1e6
"""Largest number in an array: sums of products must stay within 32 bits."""
NOT_HASHED = ("content_sha256", "made_with")
"""Keys of the manifest that are not content."""


@dataclass(frozen=True, eq=False)
class ModelContent:
    """All that the hash of a model file covers: its manifest, and the other entries by name."""

    manifest: dict[str, Any]
    entries: Entries

    @classmethod
    def of(cls, manifest: dict[str, Any], entries: Entries) -> ModelContent:
        """Return content of the present format."""
        return cls({"format": FORMAT, "format_version": FORMAT_VERSION, **manifest}, entries)

    @cached_property
    def sha256(self) -> str:
        """The SHA-256 of the content, hexadecimal."""
        return _hash(self.manifest, self.entries)


def write_content(content: ModelContent, path: Path) -> None:
    """Write a model file; an older file of that name stays until the new one is complete."""
    manifest = {
        **content.manifest,
        "content_sha256": content.sha256,
        "made_with": {name: metadata.version(name) for name in ("slam-bof", "scikit-learn")},
    }
    entries = {"manifest.json": json.dumps(manifest, indent=2).encode(), **content.entries}
    unfinished = path.with_name(path.name + ".part")
    unfinished.write_bytes(zip_entries(entries, zipfile.ZIP_DEFLATED))
    os.replace(unfinished, path)


def read_content(path: Path) -> ModelContent:
    """Read a model file.

    Raises
    ------
    ModelError
        If the file is missing, is no model, has another format version, or is damaged.
    """
    try:
        data = read_bytes(path)
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file") from None
    except OSError as error:
        raise ModelError(f"{path}: model file cannot be read: {error.strerror}") from None
    return parse_content(data, str(path))


def parse_content(data: bytes, name: str) -> ModelContent:
    """Return the content of the bytes of a model file, which messages call ``name``.

    Raises
    ------
    ModelError
        If it is no model, has another format version, or is damaged.
    """
    try:
        entries = read_entries(data)
        manifest = json.loads(entries.pop("manifest.json"))
        found = manifest["format"], manifest["format_version"], manifest["content_sha256"]
    except UNREADABLE:
        raise ModelError(
            f"{name}: not a model file; expected a zip with a slam_bof manifest.json"
        ) from None
    if found[:2] != (FORMAT, FORMAT_VERSION):
        raise ModelError(
            f"{name}: found {repr(found[0])[:80]} format version {repr(found[1])[:80]}, "
            f"expected {FORMAT!r} version {FORMAT_VERSION}"
        )
    content = ModelContent({k: v for k, v in manifest.items() if k not in NOT_HASHED}, entries)
    if content.sha256 != found[2]:
        raise ModelError(
            f"{name}: damaged: found content hash {content.sha256[:12]}, expected "
            f"{str(found[2])[:12]} as its manifest says"
        )
    return content


def stated_hash(file: Traversable) -> str | None:
    """Return the content hash that a model file's manifest states."""
    with file.open("rb") as data, zipfile.ZipFile(data) as archive:
        found = json.loads(archive.read("manifest.json")).get("content_sha256")
    return None if found is None else str(found)


def parse_arrays(entries: Entries, folder: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of the entries in a folder, by their names."""
    return {
        name.removeprefix(f"{folder}/").removesuffix(".npy"): parse_array(entries, name)
        for name in entries
        if name.startswith(f"{folder}/")
    }


def parse_array(entries: Entries, name: str) -> NDArray[Any]:
    """Return the array of an entry; ``ValueError`` unless it has finite numbers, and some."""
    try:
        array = parse_npy(entries[name])
        if array.dtype.kind != "f" or not array.size or not np.isfinite(array).all():
            raise ValueError(f"found {array.dtype} {array.shape}, expected finite numbers")
        if (largest := float(np.abs(array).max())) > MAX_WEIGHT:
            raise ValueError(f"found numbers up to {largest:g}, expected {MAX_WEIGHT:g} at most")
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    return array


def array_bytes(array: NDArray[Any]) -> bytes:
    """Return an array as the bytes of an entry."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _hash(manifest: dict[str, Any], entries: Entries) -> str:
    digest = hashlib.sha256(json.dumps(manifest, sort_keys=True).encode())
    for name in sorted(entries):
        digest.update(f"\n{name} {len(entries[name])}\n".encode())
        digest.update(entries[name])
    return digest.hexdigest()
