"""The trained model in one file: parameters, words, idf and scene classifier.

The file is a zip: ``manifest.json`` (format version, parameters, what it was trained on, and
the SHA-256 of all the content), ``words.npy``, ``idf.npy``, ``scenes.skops`` where bags are
labelled, and ``levels/*.npy`` where levelled views are. Nothing is pickled, and only the types
named here are made on loading. The same training writes the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from sklearn.exceptions import InconsistentVersionWarning

from slam_bof.bof import PlaceDescriber, PlaceParams, TfIdf, Vocabulary
from slam_bof.errors import ModelError
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.scenes.labeller import BagLabeller, Labeller
from slam_bof.scenes.levelled_classifier import LevelScenes

__all__ = [
    "FORMAT_VERSION",
    "Model",
    "classifier_bytes",
    "load",
    "load_default",
    "load_scenes",
    "save",
]

FORMAT = "slam_bof model"
FORMAT_VERSION = 1

TRUSTED_TYPES = [
    "scipy.sparse._csr.csr_array",
    "scipy.sparse._csr.csr_matrix",
    "slam_bof.scenes.SceneClassifier",
    "sklearn.calibration._CalibratedClassifier",
    "sklearn.calibration._SigmoidCalibration",
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.tree._tree.Tree",
]
"""What a classifier may be made of, beyond what skops itself trusts."""

LEVELS = "levels/"

Entries = dict[str, bytes]


@dataclass(frozen=True, eq=False)
class Model:
    """All that describing and labelling a frame needs.

    ``trained_on`` says in words which frames it has seen. ``scenes`` labels bags, as the paper
    does, and ``levels`` levelled views; both are None where the frames had no labels, and either
    where it was not asked for.
    """

    places: PlaceParams
    vocabulary: Vocabulary
    tf_idf: TfIdf
    scenes: SceneClassifier | None
    trained_on: str
    levels: LevelScenes | None = None

    def describer(self) -> PlaceDescriber:
        """Return what makes bags of frames."""
        return PlaceDescriber(self.places, self.vocabulary, self.tf_idf)

    def labeller(self) -> Labeller | None:
        """Return what labels frames: by levelled views if it can, or else by bags.

        None where the model was trained without labels.
        """
        if self.levels is not None:
            return self.levels
        return BagLabeller(self.describer(), self.scenes) if self.scenes is not None else None

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the content, hexadecimal, as the file's manifest has it."""
        return _hash(_description(self), _entries(self))


def save(model: Model, path: str | Path) -> None:
    """Write a model file; an older file of that name stays whole until the new one is."""
    path = Path(path)
    entries = _entries(model)
    description = _description(model)
    manifest = {
        **description,
        "content_sha256": _hash(description, entries),
        "made_with": {name: metadata.version(name) for name in ("slam-bof", "scikit-learn")},
    }
    entries = {"manifest.json": json.dumps(manifest, indent=2).encode(), **entries}
    unfinished = path.with_name(path.name + ".part")
    unfinished.write_bytes(_zip(entries, zipfile.ZIP_DEFLATED))
    os.replace(unfinished, path)


def load(path: str | Path) -> Model:
    """Read a model file.

    Raises
    ------
    ModelError
        If the file is missing, no model, of another format version, or damaged.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file") from None
    except OSError as error:
        raise ModelError(f"{path}: model file cannot be read: {error.strerror}") from None
    return _parse(data, str(path))


def load_default() -> Model:
    """Read the model that comes with slam_bof, trained on synthetic rooms only."""
    file = resources.files("slam_bof") / "data" / "default.bof"
    if not file.is_file():
        raise ModelError(f"{file}: no such model file; scripts/train_default_model makes it")
    return _parse(file.read_bytes(), str(file))


def _parse(data: bytes, name: str) -> Model:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = {entry: archive.read(entry) for entry in archive.namelist()}
        manifest = json.loads(entries.pop("manifest.json"))
        found = manifest["format"], manifest["format_version"], manifest["content_sha256"]
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, TypeError, ValueError):
        raise ModelError(
            f"{name}: not a model file; expected a zip with a slam_bof manifest.json"
        ) from None
    if found[:2] != (FORMAT, FORMAT_VERSION):
        raise ModelError(
            f"{name}: found {found[0]!r} format version {found[1]!r}, "
            f"expected {FORMAT!r} version {FORMAT_VERSION}"
        )
    ours = ("content_sha256", "made_with")
    content_hash = _hash({k: v for k, v in manifest.items() if k not in ours}, entries)
    if content_hash != found[2]:
        raise ModelError(
            f"{name}: damaged: found content hash {content_hash[:12]}, expected "
            f"{str(found[2])[:12]} as its manifest says"
        )
    try:
        model = _build(manifest, entries)
    except (KeyError, TypeError, ValidationError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ModelError(f"{name}: model content is not as expected: {reason}") from error
    # A cached property: what was just checked need not be computed again.
    vars(model)["content_hash"] = content_hash
    return model


def _build(manifest: dict[str, Any], entries: Entries) -> Model:
    places = PlaceParams.model_validate(manifest["places"])
    words, idf = _array(entries["words.npy"]), _array(entries["idf.npy"])
    if words.shape != (len(idf), places.bof.n_values):
        raise ValueError(
            f"words must be ({len(idf)}, {places.bof.n_values}) as idf and n_values, "
            f"got {words.shape}"
        )
    return Model(
        places=places,
        vocabulary=Vocabulary.from_words(words, **manifest["vocabulary"]),
        tf_idf=TfIdf.from_idf(idf),
        scenes=load_scenes(entries["scenes.skops"]) if "scenes.skops" in entries else None,
        trained_on=manifest["trained_on"],
        levels=_load_levels(manifest["levels"], entries) if manifest.get("levels") else None,
    )


def _description(model: Model) -> dict[str, Any]:
    """Return the manifest without what does not belong to the content."""
    vocabulary = model.vocabulary.get_params()
    del vocabulary["n_words"]  # known from the words
    description = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "trained_on": model.trained_on,
        "places": model.places.model_dump(mode="json"),
        "vocabulary": vocabulary,
        "classes": [str(label) for label in model.scenes.classes_] if model.scenes else [],
    }
    # Files of models without it are as they were.
    return description | ({"levels": model.levels.description()} if model.levels else {})


def _entries(model: Model) -> Entries:
    entries = {
        "words.npy": _array_bytes(model.vocabulary.words_),
        "idf.npy": _array_bytes(model.tf_idf.idf_),
    }
    if model.scenes is not None:
        entries["scenes.skops"] = classifier_bytes(model.scenes)
    if model.levels is not None:
        for name, array in model.levels.arrays().items():
            entries[f"{LEVELS}{name}.npy"] = _array_bytes(array)
    return entries


def _load_levels(description: dict[str, Any], entries: Entries) -> LevelScenes:
    arrays = {
        name.removeprefix(LEVELS).removesuffix(".npy"): _array(data)
        for name, data in entries.items()
        if name.startswith(LEVELS)
    }
    return LevelScenes.from_arrays(description, arrays)


def _hash(description: dict[str, Any], entries: Entries) -> str:
    digest = hashlib.sha256(json.dumps(description, sort_keys=True).encode())
    for name in sorted(entries):
        digest.update(f"\n{name} {len(entries[name])}\n".encode())
        digest.update(entries[name])
    return digest.hexdigest()


def _zip(entries: Entries, compression: int) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in entries.items():
            # A ZipInfo made by hand bears no time of writing.
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return buffer.getvalue()


def _array_bytes(array: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _array(data: bytes) -> NDArray[Any]:
    return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))


def classifier_bytes(scenes: SceneClassifier) -> bytes:
    """Return a scene classifier as model files hold it: skops, the same bytes every time."""
    import skops.io

    # skops names objects and files by memory address: number them as they come instead.
    with zipfile.ZipFile(io.BytesIO(skops.io.dumps(scenes))) as archive:
        schema = json.loads(archive.read("schema.json"))
        renamed = _number_ids(schema)
        files = {new: archive.read(old) for old, new in renamed.items()}
    return _zip({**files, "schema.json": json.dumps(schema).encode()}, zipfile.ZIP_STORED)


def _number_ids(schema: Any) -> dict[str, str]:
    """Renumber the ids and files of a skops schema in place; return the files' new names."""
    ids: dict[int, int] = {}
    files: dict[str, str] = {}

    def visit(node: Any) -> None:
        if isinstance(node, dict):
            if isinstance(node.get("__id__"), int):
                node["__id__"] = ids.setdefault(node["__id__"], len(ids) + 1)
            if isinstance(node.get("file"), str):
                suffix = Path(node["file"]).suffix
                node["file"] = files.setdefault(node["file"], f"{len(files)}{suffix}")
        for child in node.values() if isinstance(node, dict) else node:
            if isinstance(child, dict | list):
                visit(child)

    visit(schema)
    return files


def load_scenes(data: bytes) -> SceneClassifier:
    """Read what ``classifier_bytes`` wrote; ``ValueError`` where it is something else."""
    import skops.io
    from skops.io.exceptions import UntrustedTypesFoundException

    with warnings.catch_warnings():
        # Another version of scikit-learn reads these plain attributes as well.
        warnings.simplefilter("ignore", InconsistentVersionWarning)
        try:
            scenes = skops.io.loads(data, trusted=TRUSTED_TYPES)
        except UntrustedTypesFoundException as error:
            raise ValueError(str(error)) from error
    if not isinstance(scenes, SceneClassifier):
        raise ValueError(f"scenes must be a SceneClassifier, got {type(scenes).__name__}")
    return scenes
