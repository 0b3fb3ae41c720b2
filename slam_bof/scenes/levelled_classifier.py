"""Scene labels from levelled point clouds: height profile, what furniture is seen, a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from slam_bof.bof import Vocabulary
from slam_bof.core import one_native_thread
from slam_bof.scenes.certainty import NO_WARMING, Warming, fit_certainty
from slam_bof.scenes.continued_training import continue_network
from slam_bof.scenes.frame_features import LevelledFeatures, levelled_features
from slam_bof.scenes.furniture_network import FurnitureNetwork
from slam_bof.scenes.height_profile import N_PROFILE_VALUES
from slam_bof.scenes.mlp_ensemble import MlpEnsemble
from slam_bof.scenes.shape_words import N_SHAPE_VALUES
from slam_bof.types import Array, Bag, DepthFrame, Scene

__all__ = [
    "N_WORDS",
    "LevelledClassifier",
    "room_network",
    "sample_weights",
    "with_copies",
]

MIN_SCALE, MIN_TEMPERATURE = 1e-9, 1e-3
"""Least numbers that a model may divide by."""

N_WORDS = 400
"""Number of shape words in models that have some."""
MAX_SHAPES = 40_000
"""The vocabulary is learnt from at most this many shapes, drawn at random."""
FURNITURE = "furniture_"
"""What the names of a furniture network's arrays begin with."""
NETWORK_ARRAYS = ("mean", "scale", "hidden", "hidden_bias", "out", "out_bias")


def room_network(seed: int = 0) -> MlpEnsemble:
    """Return a network, not fitted yet, for a few hundred images of many rooms."""
    return MlpEnsemble(
        n_hidden=64, n_networks=4, n_steps=600, n_folds=5, n_components=160, seed=seed
    )


@dataclass(frozen=True, eq=False)
class LevelledClassifier:
    """A ``Labeller`` by levelled features: a network on them, and a vocabulary of shapes, if any.

    The network's input is the height profile, what the network ``furniture`` sees, if there is one,
    and with a vocabulary the histogram of shape words. The temperature of its logits is multiplied
    by the factor of ``warming`` for the view.
    """

    vocabulary: Vocabulary | None
    network: MlpEnsemble
    warming: Warming = NO_WARMING
    furniture: FurnitureNetwork | None = None

    @classmethod
    @one_native_thread()  # so that the same frames give the same bytes
    def fit(
        cls,
        features: Sequence[LevelledFeatures],
        labels: Sequence[str],
        groups: ArrayLike | None = None,
        *,
        n_groups: int | None = None,
        n_words: int = 0,
        network: MlpEnsemble | None = None,
        copies: Sequence[Sequence[LevelledFeatures]] = (),
        weights: ArrayLike | None = None,
        calibrate_on: NDArray[np.bool_] | None = None,
        unknown: Sequence[LevelledFeatures] = (),
        unknown_weights: ArrayLike | None = None,
        furniture: FurnitureNetwork | None = None,
        seed: int = 0,
    ) -> Self:
        """Learn a network and, with ``n_words``, a vocabulary of shapes.

        Where groups are rooms, ``fit_certainty`` then fits how certain labels are.

        Parameters
        ----------
        features, labels
            (N,) features of each training frame, and its label.
        groups, n_groups
            As in ``MlpEnsemble.fit``.
        n_words
            Number of shape words, which features with shapes are needed for; fewer where there are
            fewer shapes. By default there are none: in no comparison do they add anything.
        network
            The network to fit, by default ``MlpEnsemble`` with its default parameters.
        copies
            (N,) features of each frame as other sensors would have measured it; see
            ``augmentation``. Training uses them like frames of the same group.
        weights
            (N,) weight of each frame; by default equal. Classes are then weighted by the root of
            their number of frames.
        calibrate_on
            (N,) whether a frame counts for the temperature; by default all do. Copies never do.
        unknown, unknown_weights
            Features of frames that show none of the classes, and their weights. Their labels are to
            be as uncertain as possible.
        furniture
            The network that the features are from, which stays as it is.
        seed
            Seed of the vocabulary and of the default network.
        """
        vocabulary = _learn_words(features, n_words, seed) if n_words else None
        classifier = cls(vocabulary, network or MlpEnsemble(seed=seed), furniture=furniture)
        vectors, frame_of = classifier._feature_vectors(features, copies)
        y = np.asarray(labels)[frame_of]
        counted = np.ones(len(features), bool) if calibrate_on is None else calibrate_on
        classifier.network.fit(
            vectors,
            y,
            None if groups is None else np.asarray(groups)[frame_of],
            n_groups=n_groups,
            weights=None if weights is None else sample_weights(weights, y, frame_of),
            calibrate_on=counted[frame_of] & (np.arange(len(y)) < len(features)),
        )
        if weights is None or groups is None:
            return classifier
        network, of_frames = classifier.network, np.flatnonzero(counted)
        logits, weight = network.held_out_[of_frames], np.asarray(weights, np.float64)[of_frames]
        if unknown:
            of_unknown = np.ones(len(unknown)) if unknown_weights is None else unknown_weights
            vectors, _ = classifier._feature_vectors(unknown, ())
            logits = np.concatenate([logits, network.logits(vectors)])
            weight = np.concatenate([weight, of_unknown])
        profiles = [item.profile for item in (*(features[k] for k in of_frames.tolist()), *unknown)]
        network.temperature_, warming = fit_certainty(
            logits, np.searchsorted(network.classes_, y[of_frames]), np.array(profiles), weight
        )
        return replace(classifier, warming=warming)

    def continue_training(
        self,
        features: Sequence[LevelledFeatures],
        labels: Sequence[str],
        *,
        copies: Sequence[Sequence[LevelledFeatures]] = (),
    ) -> LevelledClassifier:
        """Return a classifier that learnt from further frames too; see ``continued_training``.

        Parameters are those of ``fit``. The vocabulary stays.
        """
        vectors, frame_of = self._feature_vectors(features, copies)
        y = np.asarray(labels)[frame_of]
        weights = sample_weights(np.ones(len(features)), y, frame_of)
        return replace(self, network=continue_network(self.network, vectors, y, weights))

    def manifest(self) -> dict[str, Any]:
        """Return the parameters and classes, as a model file's manifest holds them."""
        classes = [str(label) for label in self.network.classes_]
        network = self.network.get_params()
        if network["n_components"] is None:
            del network["n_components"]  # as in files older than this parameter
        found = {"network": network, "classes": classes}
        if self.vocabulary is None:
            return found
        vocabulary = self.vocabulary.get_params()
        del vocabulary["n_words"]  # known from the words
        return {"vocabulary": vocabulary, **found}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that were learnt, by name."""
        learnt = {name: getattr(self.network, f"{name}_") for name in NETWORK_ARRAYS}
        temperature = np.array(self.network.temperature_)
        words = {} if self.vocabulary is None else {"words": self.vocabulary.words_}
        seen = {} if self.furniture is None else self.furniture.arrays()
        furniture = {f"{FURNITURE}{name}": array for name, array in seen.items()}
        return {
            **words, "temperature": temperature, **learnt, **self.warming.arrays(), **furniture
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, manifest: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Self:
        """Restore a classifier from its ``manifest`` and ``arrays``.

        Raises
        ------
        KeyError, TypeError, ValueError
            If something is missing or unknown, or shapes do not fit each other.
        """
        classes = np.array(manifest["classes"])
        words = np.empty((0, N_SHAPE_VALUES), np.float32)
        if "vocabulary" in manifest:
            words = arrays["words"]
        furniture, n_features = None, N_PROFILE_VALUES + len(words)
        names = [name for name in arrays if name.startswith(FURNITURE)]
        if names:
            weights = {name.removeprefix(FURNITURE): arrays[name] for name in names}
            furniture = FurnitureNetwork.from_arrays(weights)
            n_features += furniture.n_values
        network = MlpEnsemble(**manifest["network"])
        n_neurons = network.n_networks * network.n_hidden
        shapes = {
            "temperature": (),
            "mean": (n_features,),
            "scale": (n_features,),
            "hidden": (n_features, n_neurons),
            "hidden_bias": (n_neurons,),
            "out": (n_neurons, len(classes)),
            "out_bias": (len(classes),),
        }
        if words.shape[1:] != (N_SHAPE_VALUES,):
            raise ValueError(f"levels/words must be (N, {N_SHAPE_VALUES}), got {words.shape}")
        for name, shape in shapes.items():
            if arrays[name].shape != shape:
                raise ValueError(f"levels/{name} must be {shape}, got {arrays[name].shape}")
        if len(set(manifest["classes"])) != len(classes) or classes.dtype.kind != "U":
            raise ValueError(f"classes must be different names, got {manifest['classes']}")
        for name, least in (("scale", MIN_SCALE), ("temperature", MIN_TEMPERATURE)):
            if (found := float(arrays[name].min())) < least:
                raise ValueError(f"levels/{name}: found {found:g}, expected {least:g} or more")
        for name in NETWORK_ARRAYS:
            setattr(network, f"{name}_", arrays[name])
        network.classes_, network.n_features_in_ = classes, n_features
        network.temperature_ = float(arrays["temperature"])
        vocabulary = None
        if "vocabulary" in manifest:
            vocabulary = Vocabulary.from_words(words, **manifest["vocabulary"])
        return cls(vocabulary, network, Warming.from_arrays(arrays), furniture)

    def _feature_vectors(
        self, features: Sequence[LevelledFeatures], copies: Sequence[Sequence[LevelledFeatures]]
    ) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        """Return the network's inputs (M, D) for frames and copies, and the frame of each (M,)."""
        everything, frame_of = with_copies(features, copies)
        return np.array([self.feature_vector(item) for item in everything]), frame_of

    def feature_vector(self, features: LevelledFeatures) -> NDArray[np.float32]:
        """Return the network's input: the profile, furniture, and roots of word frequencies.

        Raises
        ------
        ValueError
            If the features lack what the furniture network sees.
        """
        parts = [features.profile]
        if self.furniture is not None:
            if features.furniture is None:
                raise ValueError("found features without furniture, expected those of the network")
            parts.append(features.furniture)
        if self.vocabulary is None:
            return np.concatenate(parts)
        words = self.vocabulary.lookup(features.shapes)
        counts = np.bincount(words, minlength=self.vocabulary.n_words)
        frequencies = counts / max(len(words), 1)
        return np.concatenate([*parts, np.sqrt(frequencies)], dtype=np.float32)

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene that a frame shows; the bag is not used."""
        with_shapes = self.vocabulary is not None
        return self.label_features(
            levelled_features(
                frame,
                gravity_camera=gravity_camera,
                with_shapes=with_shapes,
                furniture=self.furniture,
            )
        )

    def label_features(self, features: LevelledFeatures) -> Scene:
        """Return the scene by the features of a frame, and by both heights if two may be.

        A label that hangs on where the floor is assumed is thus not certain.
        """
        probabilities = self._probabilities(features)
        if features.otherwise is not None:
            probabilities = _agreed(probabilities, self._probabilities(features.otherwise))
        best = int(probabilities.argmax())
        classes = tuple(str(label) for label in self.network.classes_)
        return Scene(classes[best], float(probabilities[best]), classes, probabilities)

    def _probabilities(self, features: LevelledFeatures) -> Array:
        logits = self.network.logits(self.feature_vector(features)[None])[0].astype(np.float64)
        factor = self.warming.factors(features.profile[None])[0]
        return np.asarray(softmax(logits / (self.network.temperature_ * factor)))


def _agreed(first: Array, second: Array) -> Array:
    """Return the probabilities (C,) that two assumptions agree on; what is left says nothing.

    The geometric mean sums to the Bhattacharyya coefficient, 1 if both are equal and 0 if they have
    no class in common. The remainder goes to all classes equally. An arithmetic mean would be wrong
    for views in a row, which all have the same camera: what one assumption says of each of them
    would be multiplied as if the other had been refuted.
    """
    both = np.sqrt(first * second)
    return np.asarray(both + max(1.0 - both.sum(), 0.0) / len(both))


def _learn_words(features: Sequence[LevelledFeatures], n_words: int, seed: int) -> Vocabulary:
    shapes = np.concatenate([item.shapes for item in features])
    if len(shapes) == 0:
        shapes = np.zeros((1, features[0].shapes.shape[1]), np.float32)
    if len(shapes) > MAX_SHAPES:
        rng = np.random.default_rng(seed)
        shapes = shapes[np.sort(rng.permutation(len(shapes))[:MAX_SHAPES])]
    return Vocabulary(n_words=min(n_words, len(shapes)), seed=seed).fit(shapes)


def with_copies(
    features: Sequence[LevelledFeatures], copies: Sequence[Sequence[LevelledFeatures]]
) -> tuple[list[LevelledFeatures], NDArray[np.intp]]:
    """Return the features of frames, then of their copies, and the frame of each (M,)."""
    of_copies = [k for k, items in enumerate(copies) for _ in items]
    everything = [*features, *(item for items in copies for item in items)]
    return everything, np.array([*range(len(features)), *of_copies])


def sample_weights(weights: ArrayLike, y: NDArray[Any], frame_of: NDArray[np.intp]) -> Array:
    """Return the weight of each sample, divided by the root of its class's sum of weights."""
    weight = np.asarray(weights, np.float64)[frame_of]
    _, index = np.unique(y, return_inverse=True)
    weight /= np.sqrt(np.bincount(index, weight))[index]
    return np.asarray(weight * len(weight) / weight.sum())
