"""Scene labels from a view's set of placed BOFs and its height profile, by a set transformer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from slam_bof.scenes.certainty import NO_WARMING, Warming, fit_certainty
from slam_bof.scenes.classifiers import check_class_counts
from slam_bof.scenes.contour_tokens import N_TOKEN_VALUES, contour_tokens
from slam_bof.scenes.folds import make_folds
from slam_bof.scenes.frame_features import LevelledFeatures
from slam_bof.scenes.height_profile import N_PROFILE_VALUES, measure_profile
from slam_bof.scenes.levelled_classifier import MIN_TEMPERATURE, sample_weights, with_copies
from slam_bof.scenes.levelled_cloud import levelled_cloud
from slam_bof.scenes.set_transformer import SetTransformer, TransformerShape
from slam_bof.scenes.set_transformer_training import (
    TransformerTraining,
    View,
    fit_transformer,
    transformer_logits,
)
from slam_bof.types import Array, Bag, DepthFrame, Scene

__all__ = ["ConstellationClassifier"]

N_FOLDS = 2
"""Folds by group for the temperature."""


@dataclass(frozen=True, eq=False)
class ConstellationClassifier:
    """A ``Labeller`` by the tokens and the height profile of a view.

    The temperature of the network's logits is multiplied by the factor of ``warming``.
    """

    network: SetTransformer
    classes: tuple[str, ...]
    temperature: float = 1.0
    warming: Warming = NO_WARMING

    def label(
        self, frame: DepthFrame, *, gravity_camera: Array | None = None, bag: Bag | None = None
    ) -> Scene:
        """Return the scene that a frame shows; the bag is not used."""
        cloud = levelled_cloud(frame, gravity_camera=gravity_camera)
        profile, tokens = measure_profile(cloud), contour_tokens(cloud)
        return self.label_features(LevelledFeatures(profile, tokens[:0], tokens=tokens))

    def label_features(self, features: LevelledFeatures) -> Scene:
        """Return the scene by the features of a frame, which have tokens."""
        profile, tokens = _view(features)
        factor = float(self.warming.factors(features.profile[None])[0])
        logits = self.network.logits(profile, tokens).astype(np.float64)
        probabilities = softmax(logits / (self.temperature * factor))
        best = int(probabilities.argmax())
        return Scene(self.classes[best], float(probabilities[best]), self.classes, probabilities)

    @classmethod
    def fit(
        cls,
        features: Sequence[LevelledFeatures],
        labels: Sequence[str],
        groups: ArrayLike | None = None,
        *,
        copies: Sequence[Sequence[LevelledFeatures]] = (),
        weights: ArrayLike | None = None,
        calibrate_on: NDArray[np.bool_] | None = None,
        unknown: Sequence[LevelledFeatures] = (),
        unknown_weights: ArrayLike | None = None,
        training: TransformerTraining | None = None,
        start: SetTransformer | None = None,
    ) -> Self:
        """Train the network with PyTorch, then fit how certain it is on groups held out.

        Parameters are those of ``LevelledClassifier.fit``, and ``training`` and ``start`` of
        ``fit_transformer``. Features need tokens.

        Raises
        ------
        PluginError
            If PyTorch is not installed.
        """
        training = training or TransformerTraining()
        everything, frame_of = with_copies(features, copies)
        views = [_view(item) for item in everything]
        weight = np.ones(len(features)) if weights is None else np.asarray(weights, np.float64)
        y = np.asarray(labels)[frame_of]
        classes, index = np.unique(y, return_inverse=True)
        check_class_counts(classes, np.bincount(index))
        drawn = sample_weights(weight, y, frame_of)
        shape = TransformerShape(
            n_profile=len(views[0][0]), n_token=views[0][1].shape[1], n_classes=len(classes)
        )

        def fit_on(rows: NDArray[np.intp]) -> SetTransformer:
            chosen = [views[k] for k in rows.tolist()]
            return fit_transformer(
                chosen, index[rows], shape, training, weights=drawn[rows], start=start
            )

        counted = np.ones(len(features), bool) if calibrate_on is None else calibrate_on
        logits = np.zeros((len(features), len(classes)), np.float32)
        of_group = None if groups is None else np.asarray(groups)[frame_of]
        for train, test in make_folds(index, of_group, N_FOLDS, training.seed):
            own = test[test < len(features)]
            own = own[counted[own]]
            logits[own] = transformer_logits(fit_on(train), [views[k] for k in own.tolist()])
        network = fit_on(np.arange(len(views)))
        rows = np.flatnonzero(counted)
        others = transformer_logits(network, [_view(item) for item in unknown])
        of_unknown = np.ones(len(unknown)) if unknown_weights is None else unknown_weights
        known = [features[k] for k in rows.tolist()]
        temperature, warming = fit_certainty(
            np.concatenate([logits[rows], others]),
            index[rows],
            np.array([item.profile for item in (*known, *unknown)]),
            np.concatenate([weight[rows], np.asarray(of_unknown, np.float64)]),
        )
        return cls(network, tuple(classes.tolist()), temperature, warming)

    def manifest(self) -> dict[str, Any]:
        """Return the network's shape and the classes, as a model file's manifest holds them."""
        return {"network": asdict(self.network.shape), "classes": list(self.classes)}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that were learnt, by name."""
        temperature = {"temperature": np.array(self.temperature)}
        return self.network.arrays() | temperature | self.warming.arrays()

    @classmethod
    def from_arrays(cls, manifest: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Restore a classifier from its ``manifest`` and ``arrays``.

        Raises
        ------
        KeyError, TypeError, ValueError
            If something is missing or unknown, or shapes do not fit each other.
        """
        shape, classes = TransformerShape(**manifest["network"]), tuple(manifest["classes"])
        if len(set(classes)) != shape.n_classes or not all(type(name) is str for name in classes):
            raise ValueError(f"classes must be {shape.n_classes} names, got {classes!r:.200}")
        if (shape.n_profile, shape.n_token) != (N_PROFILE_VALUES, N_TOKEN_VALUES):
            raise ValueError(
                f"network must have {N_PROFILE_VALUES} values of a profile and {N_TOKEN_VALUES} of "
                f"a token, got {shape.n_profile} and {shape.n_token}"
            )
        temperature = arrays["temperature"]
        if temperature.shape != () or not temperature >= MIN_TEMPERATURE:
            raise ValueError(
                f"constellation/temperature must be a number, {MIN_TEMPERATURE:g} or more"
            )
        network = SetTransformer.from_arrays(shape, arrays)
        return cls(network, classes, float(temperature), Warming.from_arrays(arrays))


def _view(features: LevelledFeatures) -> View:
    if features.tokens is None:
        raise ValueError("features must have tokens, got none")
    return features.profile, features.tokens
