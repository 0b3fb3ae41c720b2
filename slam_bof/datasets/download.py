"""Download data sets from their official servers and unpack them."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slam_bof.datasets.download_archive import BadArchive, unpack
from slam_bof.datasets.download_catalogue import Archive, find_archives
from slam_bof.datasets.download_http import fetch
from slam_bof.datasets.download_sums import check_sum, record_sum
from slam_bof.errors import DatasetError

__all__ = ["Downloaded", "OnProgress", "download"]

OnProgress = Callable[[str, int, int], None]
"""Called with the current task and file, and with bytes done and in total (0 if unknown)."""


@dataclass(frozen=True, slots=True)
class Downloaded:
    """The folder of a data set, and whether it was there before the download."""

    folder: Path
    was_there: bool


def download(
    collection: str,
    part: str | None,
    out: Path,
    *,
    base_url: str | None = None,
    keep_archive: bool = False,
    on_progress: OnProgress = lambda what, done, total: None,
) -> list[Downloaded]:
    """Download a part of a data set to ``out/COLLECTION/``, unless its folder exists.

    An archive that exists is not downloaded again. An interrupted download is continued. A folder
    appears when it is unpacked completely. The SHA-256 of the archive is recorded in
    ``out/COLLECTION/SHA256SUMS``; a later download of another one is refused.

    Parameters
    ----------
    collection, part
        Names in the catalogue: ``7scenes`` and ``chess``, ``tum`` and ``fr1/desk``, ``sunrgbd``.
    out
        Folder for data sets.
    base_url
        URL of a folder with the archives, used instead of the official one.
    keep_archive
        Whether to keep the archives beside their contents.
    on_progress
        Called with the progress.

    Returns
    -------
    list of Downloaded
        The folders, in the order of the catalogue.

    Raises
    ------
    DatasetError
        If there is no such part, or downloading or unpacking fails.
    """
    return [
        _download(archive, out / collection, base_url, keep_archive, on_progress)
        for archive in find_archives(collection, part)
    ]


def _download(
    archive: Archive,
    out: Path,
    base_url: str | None,
    keep_archive: bool,
    on_progress: OnProgress,
) -> Downloaded:
    folder = out / archive.folder
    if folder.exists():
        return Downloaded(folder, was_there=True)
    url = f"{base_url.rstrip('/')}/{archive.file_name}" if base_url else archive.url
    file = out / archive.file_name
    fetch(url, file, progress=lambda *sizes: on_progress(f"Downloading {file.name}", *sizes))
    sha256 = check_sum(file)
    # On the same file system, so that the folder can be moved in one step.
    trial = out / f".{archive.folder}.unpacking"
    shutil.rmtree(trial, ignore_errors=True)
    try:
        unpack(file, trial, progress=lambda *sizes: on_progress(f"Unpacking {file.name}", *sizes))
        if not (trial / archive.folder).is_dir():
            found = ", ".join(sorted(path.name for path in trial.iterdir())[:5]) or "nothing"
            raise BadArchive(f"{file}: found {found} inside, expected {archive.folder}/")
        (trial / archive.folder).replace(folder)
        record_sum(file, sha256)
    except BadArchive as error:
        # Renamed, so that the next call downloads it again.
        bad = file.with_name(file.name + ".bad")
        with contextlib.suppress(OSError):
            file.replace(bad)
        raise DatasetError(f"{error}; renamed to {bad.name}") from error
    finally:
        shutil.rmtree(trial, ignore_errors=True)
    if not keep_archive:
        file.unlink()
    return Downloaded(folder, was_there=False)
