"""Set transformers of random weights, which need no PyTorch."""

from __future__ import annotations

import numpy as np

from slam_bof.scenes import ConstellationClassifier
from slam_bof.scenes.contour_tokens import N_TOKEN_VALUES
from slam_bof.scenes.height_profile import N_PROFILE_VALUES
from slam_bof.scenes.set_transformer import SetTransformer, TransformerShape


def random_network(shape: TransformerShape, seed: int = 0) -> SetTransformer:
    rng = np.random.default_rng(seed)
    weights = {k: 0.3 * rng.standard_normal(n, np.float32) for k, n in shape.weights().items()}
    n_values = shape.n_profile + shape.n_token
    return SetTransformer(
        shape, weights, np.zeros(n_values, np.float32), np.ones(n_values, np.float32)
    )


def random_classifier(classes: tuple[str, ...]) -> ConstellationClassifier:
    shape = TransformerShape(
        n_profile=N_PROFILE_VALUES, n_token=N_TOKEN_VALUES, n_classes=len(classes)
    )
    return ConstellationClassifier(random_network(shape), classes, 2.0)
