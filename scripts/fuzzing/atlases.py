"""Atlases: damaged files, and manifests that say what is not so."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path

import numpy as np

from fuzzing.cases import Reader, expect, quiet, turn
from fuzzing.maps import prepare_map
from fuzzing.mutations import mutate_array, mutate_bytes, mutate_json
from slam_bof.atlas import Atlas, AtlasLocalizer, describe_map
from slam_bof.geometry import se3

__all__ = ["READERS"]


def prepare_atlas(place: Path) -> None:
    """Make an atlas of two segments: a map, and others that are not there."""
    prepare_map(place)
    described = describe_map(place / "map.db")
    Atlas.add_described(place / "fleet", [(f"/none/{k}.db", described) for k in range(5)])
    Atlas.add_described(place / "fleet", [(str(place / "map.db"), described)])


def damage_atlas(place: Path, case: Path, rng: random.Random) -> None:
    """Change the manifest or a file of a segment, or leave one out."""
    fleet = shutil.copytree(place / "fleet", case / "fleet")
    manifest = fleet / "atlas.json"
    file = manifest if rng.random() < 0.4 else rng.choice(sorted(fleet.rglob("*.npy")))
    if rng.random() < 0.05:
        file.unlink()
    elif rng.random() < 0.2:
        file.write_bytes(mutate_bytes(file.read_bytes(), rng))
    elif file is manifest:
        file.write_text(json.dumps(mutate_json(json.loads(file.read_text()), rng)))
    else:
        file.write_bytes(mutate_array(file.read_bytes(), rng))


def read_atlas(place: Path, case: Path) -> None:
    """Write to a copy, and localize; the map decides, so a pose that is known must be right."""
    shutil.copytree(case / "fleet", case / "copy")
    described = describe_map(place / "map.db")
    quiet(lambda: Atlas.add_described(case / "copy", [("/none/5.db", described)]))
    quiet(lambda: Atlas.remove(case / "copy", ["/none/1.db", "/none/2.db", "/none/3.db"]))
    frames, poses = turn()
    found = AtlasLocalizer(Atlas.open(case / "fleet")).localize(frames[8])
    expect(found.map is not None or bool(found.reason), "neither a map nor a reason")
    if found.located is not None:
        T = found.located.localization.T_map_camera
        error = se3.inverse(se3.inverse(poses[0]) @ poses[8]) @ T
        expect(bool(np.linalg.norm(error[:3, 3]) < 0.1), "a pose elsewhere")


READERS = {"atlas": Reader(1, prepare_atlas, damage_atlas, read_atlas)}
