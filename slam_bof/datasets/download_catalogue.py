"""Data sets that can be downloaded: their official addresses, contents and licences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from slam_bof.core import suggest
from slam_bof.errors import DatasetError

__all__ = ["CATALOGUE", "Archive", "Collection", "find_archives"]


@dataclass(frozen=True, slots=True)
class Archive:
    """An archive to download, and the folder that it holds."""

    url: str
    folder: str

    @property
    def file_name(self) -> str:
        """Return the last part of the URL."""
        return self.url.rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class Collection:
    """A data set: its licence in words, and the archives of each part by the name of the part."""

    title: str
    licence: str
    parts: Mapping[str, tuple[Archive, ...]]


def _seven_scenes() -> Mapping[str, tuple[Archive, ...]]:
    base = "https://download.microsoft.com/download/2/8/5/28564B23-0828-408F-8631-23B1EFF1DAC8"
    scenes = ("chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs")
    return {scene: (Archive(f"{base}/{scene}.zip", scene),) for scene in scenes}


TUM_SEQUENCES = {
    1: "360 desk desk2 floor plant room rpy teddy xyz",
    2: "360_hemisphere 360_kidnap coke desk desk_with_person dishes flowerbouquet "
    "flowerbouquet_brownbackground large_no_loop large_with_loop metallic_sphere "
    "metallic_sphere2 pioneer_360 pioneer_slam pioneer_slam2 pioneer_slam3 rpy xyz",
    3: "cabinet large_cabinet long_office_household nostructure_notexture_far "
    "nostructure_notexture_near_withloop nostructure_texture_far "
    "nostructure_texture_near_withloop sitting_halfsphere sitting_rpy sitting_static sitting_xyz "
    "structure_notexture_far structure_notexture_near structure_texture_far "
    "structure_texture_near teddy walking_halfsphere walking_rpy walking_static walking_xyz",
}


def _tum() -> Mapping[str, tuple[Archive, ...]]:
    parts = {}
    for number, names in TUM_SEQUENCES.items():
        base = f"https://cvg.cit.tum.de/rgbd/dataset/freiburg{number}"
        for name in names.split():
            folder = f"rgbd_dataset_freiburg{number}_{name}"
            parts[f"fr{number}/{name}"] = (Archive(f"{base}/{folder}.tgz", folder),)
    return parts


def _sun_rgbd() -> Mapping[str, tuple[Archive, ...]]:
    base = "https://rgbd.cs.princeton.edu/data"
    folders = ("SUNRGBD", "SUNRGBDtoolbox")
    return {"all": tuple(Archive(f"{base}/{folder}.zip", folder) for folder in folders)}


CATALOGUE: Mapping[str, Collection] = {
    "7scenes": Collection(
        "Microsoft 7-Scenes (Shotton et al., CVPR 2013)",
        "Microsoft Research licence: for non-commercial research only, not to be redistributed; "
        "the terms are in the archive and at "
        "https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/",
        _seven_scenes(),
    ),
    "sunrgbd": Collection(
        "SUN RGB-D (Song et al., CVPR 2015), about 7 GB",
        "free for research with citation of it and of the sets that it contains (NYU depth v2, "
        "Berkeley B3DO, SUN3D), whose own terms hold; see https://rgbd.cs.princeton.edu/",
        _sun_rgbd(),
    ),
    "tum": Collection(
        "TUM RGB-D benchmark (Sturm et al., IROS 2012)",
        "Creative Commons Attribution 4.0 (CC BY 4.0); see "
        "https://cvg.cit.tum.de/data/datasets/rgbd-dataset",
        _tum(),
    ),
}


def find_archives(collection: str, part: str | None = None) -> tuple[Archive, ...]:
    """Return the archives of a part of a collection; of its only part if none is named.

    >>> [archive.file_name for archive in find_archives("7scenes", "chess")]
    ['chess.zip']

    Raises
    ------
    DatasetError
        If there is no such collection or part, or one must be named.
    """
    if collection not in CATALOGUE:
        known = sorted(CATALOGUE)
        raise DatasetError(f"no data set {collection!r} to download; {suggest(collection, known)}")
    parts = CATALOGUE[collection].parts
    if part is None:
        if len(parts) > 1:
            raise DatasetError(f"{collection}: which part? one of: {', '.join(parts)}")
        return next(iter(parts.values()))
    if part not in parts:
        raise DatasetError(f"{collection}: no part {part!r}; {suggest(part, list(parts))}")
    return parts[part]
