"""A trained model: vocabulary, idf and scene classifiers, and the models that come with slam_bof.

In a model file (``model_file``) are ``words.npy``, ``idf.npy``, ``scenes.skops`` for a classifier
of bags, ``levels/*.npy`` for a levelled classifier, and ``constellation/*.npy`` for one of
constellations. Loading creates objects of the types named here only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from slam_bof.bof import PlaceDescriber, PlaceParams, TfIdf, Vocabulary
from slam_bof.errors import ModelError
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.scenes.constellation_classifier import ConstellationClassifier
from slam_bof.scenes.furniture_network import FurnitureNetwork
from slam_bof.scenes.height_profile import compile_profile
from slam_bof.scenes.hmm_filter import LabelledBy
from slam_bof.scenes.labeller import BagLabeller, Labeller
from slam_bof.scenes.levelled_classifier import LevelledClassifier
from slam_bof.scenes.model_file import (
    FORMAT_VERSION,
    ModelContent,
    array_bytes,
    parse_array,
    parse_arrays,
    parse_content,
    read_content,
    stated_hash,
    write_content,
)
from slam_bof.scenes.stored_classifier import Entries, classifier_bytes, load_classifier

__all__ = [
    "FORMAT_VERSION",
    "Model",
    "has_words_of",
    "included_furniture",
    "load",
    "name_by_hash",
    "resolve",
    "save",
]

DEFAULT = "default"
INCLUDED = (DEFAULT, "synthetic")
"""Names of the models that come with slam_bof: one learnt from real and synthetic rooms, one from
synthetic rooms only, which was the default before."""
SUPERSEDED = {
    "9e04125ebb8c6a44cbd1354e83330af6c2d6fcf74e9275669e5167f5a6dde356": DEFAULT,
    "16bb13fe419f3da0b40af09d1c1f9ae2841cf9bb2009f2b8f0ab41c77f08b09d": DEFAULT,
    "122169fe3ef2a18b7113932594d603cc95f08dc0ef9f653a9a1a39c7ec87190a": DEFAULT,
    "0c1e8a57e0a439139634bdb5c45f514a2cfb78251720af8bb72dd235e43aa1d0": DEFAULT,
    "403bcc6f07672f834dab3acf8854441ef2079616095b7d08490e9b23eb37f552": DEFAULT,
    "daff55e72714452b1981776beeb732a6cf4f0ad4147297d1e25de5739b5dc689": "synthetic",
}
"""Included models by the content hashes of earlier ones, which are included no more and have the
same words, idf and classes."""
LEVELLED, CONSTELLATION = "levels", "constellation"
"""Keys of classifiers in the manifest, and folders of their arrays."""


@dataclass(frozen=True, eq=False)
class Model:
    """All that describing and labelling a frame needs.

    ``trained_on`` says in words which frames it was trained on. ``bag_classifier`` labels bags of
    words, as in the paper; ``levelled_classifier`` labels frames by levelled features, and
    ``constellation_classifier`` by a set transformer on their BOFs. Any is None where the frames
    had no labels or it was not asked for.
    """

    places: PlaceParams
    vocabulary: Vocabulary
    tf_idf: TfIdf
    bag_classifier: SceneClassifier | None
    trained_on: str
    levelled_classifier: LevelledClassifier | None = None
    constellation_classifier: ConstellationClassifier | None = None

    def describer(self) -> PlaceDescriber:
        """Return the describer that makes bags of words of frames."""
        return PlaceDescriber(self.places, self.vocabulary, self.tf_idf)

    def labeller(self, by: LabelledBy = "levelled") -> Labeller | None:
        """Return the labeller of frames; None where the model was trained without labels.

        Parameters
        ----------
        by
            ``levelled`` prefers the levelled classifier, ``bag`` takes that of bags, and
            ``constellation`` that of constellations.

        Raises
        ------
        ModelError
            If the classifier asked for was not trained, but another.
        """
        if by != "bag":
            compile_profile()
        if by == "constellation" and self.constellation_classifier is not None:
            return self.constellation_classifier
        if self.levelled_classifier is not None and by == "levelled":
            return self.levelled_classifier
        if self.bag_classifier is not None and by != "constellation":
            return BagLabeller(self.describer(), self.bag_classifier)
        if self.levelled_classifier is not None or self.bag_classifier is not None:
            raise ModelError(
                f"the model ({self.trained_on}): found no classifier of {by}s, expected one to "
                f"label by {by}s"
            )
        return None

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the content, hexadecimal, as in the file's manifest."""
        return _content(self).sha256


def save(model: Model, path: str | Path) -> None:
    """Write a model file; an older file of that name stays until the new one is complete."""
    write_content(_content(model), Path(path))


def resolve(name: str | Path | None = None) -> Model:
    """Read a model by name, one of ``INCLUDED``, or by the path of a file; None is the default.

    Raises
    ------
    ModelError
        As ``load``.
    """
    name = DEFAULT if name is None else name
    if name not in INCLUDED:
        return load(name)
    file = _included_file(str(name))
    if not file.is_file():
        raise ModelError(f"{file}: no such model file; scripts/train_default_model makes it")
    return _build(parse_content(file.read_bytes(), str(file)), str(file))


def included_furniture() -> FurnitureNetwork:
    """Return the furniture network of the default model, which others may learn from too.

    Raises
    ------
    ModelError
        If it has none.
    """
    classifier = resolve(DEFAULT).levelled_classifier
    if classifier is None or classifier.furniture is None:
        raise ModelError("the default model: found no furniture network, expected one")
    return classifier.furniture


def name_by_hash(name: str, content_hash: str | None) -> str:
    """Return the name of the model that a map was made with, or of the one in its place.

    A map names ``default`` and the content hash of what that was then. If it is not the default
    any more but still comes with slam_bof, or one with the same words does (``SUPERSEDED``), the
    name of that is returned, else ``name``.
    """
    if name == DEFAULT and content_hash is not None:
        if content_hash in SUPERSEDED:
            return SUPERSEDED[content_hash]
        for included in INCLUDED:
            file = _included_file(included)
            if file.is_file() and stated_hash(file) == content_hash:
                return included
    return name


def has_words_of(content_hash: str, name: str | Path) -> bool:
    """Return whether a model, by name, describes frames as an earlier one of that hash did."""
    return SUPERSEDED.get(content_hash) == name


def _included_file(name: str) -> Traversable:
    return resources.files("slam_bof") / "data" / f"{name}.bof"


def load(path: str | Path) -> Model:
    """Read a model file.

    Raises
    ------
    ModelError
        If the file is missing, is no model, has another format version, or is damaged.
    """
    path = Path(path)
    return _build(read_content(path), str(path))


def _build(content: ModelContent, name: str) -> Model:
    """Return the model that the content of a file is; messages call the file ``name``."""
    try:
        model = _parse(content.manifest, content.entries)
    except (LookupError, TypeError, ValidationError, ValueError) as error:
        reason = (str(error).splitlines() or ["nothing"])[0][:300]
        raise ModelError(f"{name}: model content is not as expected: {reason}") from error
    # Fill the cached property: the hash of the file, which an older version may have written.
    vars(model)["content_hash"] = content.sha256
    return model


def _parse(manifest: dict[str, Any], entries: Entries) -> Model:
    """Return the model of a manifest and entries; ``ValueError`` or the like if it is none."""
    places = PlaceParams.model_validate(manifest["places"])
    words, idf = parse_array(entries, "words.npy"), parse_array(entries, "idf.npy")
    if words.shape != (len(idf), places.bof.n_values):
        raise ValueError(
            f"words must be ({len(idf)}, {places.bof.n_values}) as idf and n_values, "
            f"got {words.shape}"
        )
    if idf.min() < 0.0:
        raise ValueError(f"idf.npy: found {idf.min()}, expected no negative frequency")
    if not isinstance(manifest["trained_on"], str):
        raise ValueError(f"trained_on must be text, got {type(manifest['trained_on']).__name__}")
    return Model(
        places=places,
        vocabulary=Vocabulary.from_words(words, **manifest["vocabulary"]),
        tf_idf=TfIdf.from_idf(idf),
        bag_classifier=(
            load_classifier(entries["scenes.skops"], len(words))
            if "scenes.skops" in entries
            else None
        ),
        trained_on=manifest["trained_on"],
        levelled_classifier=(
            LevelledClassifier.from_arrays(manifest[LEVELLED], parse_arrays(entries, LEVELLED))
            if manifest.get(LEVELLED)
            else None
        ),
        constellation_classifier=(
            ConstellationClassifier.from_arrays(
                manifest[CONSTELLATION], parse_arrays(entries, CONSTELLATION)
            )
            if manifest.get(CONSTELLATION)
            else None
        ),
    )


def _content(model: Model) -> ModelContent:
    """Return what is stored of a model."""
    vocabulary = model.vocabulary.get_params()
    del vocabulary["n_words"]  # known from the words
    bag_classifier = model.bag_classifier
    manifest = {
        "trained_on": model.trained_on,
        "places": model.places.model_dump(mode="json"),
        "vocabulary": vocabulary,
        "classes": [str(label) for label in bag_classifier.classes_] if bag_classifier else [],
    }
    entries = {
        "words.npy": array_bytes(model.vocabulary.words_),
        "idf.npy": array_bytes(model.tf_idf.idf_),
    }
    if bag_classifier is not None:
        entries["scenes.skops"] = classifier_bytes(bag_classifier)
    # Without a classifier its key is absent, as in files older than it.
    for key, classifier in _classifiers(model).items():
        manifest[key] = classifier.manifest()
        for name, array in classifier.arrays().items():
            entries[f"{key}/{name}.npy"] = array_bytes(array)
    return ModelContent.of(manifest, entries)


def _classifiers(model: Model) -> dict[str, LevelledClassifier | ConstellationClassifier]:
    """Return the classifiers of arrays that a model has, by their keys."""
    found = {LEVELLED: model.levelled_classifier, CONSTELLATION: model.constellation_classifier}
    return {key: classifier for key, classifier in found.items() if classifier is not None}
