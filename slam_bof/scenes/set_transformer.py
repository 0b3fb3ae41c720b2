"""A set transformer on a view's BOFs: each contour is a token, and tokens attend to each other.

The paper's outlook is a network on all BOFs of a view instead of their bag. Here a view is the set
of its contours (``contour_tokens``) with one more token, of its height profile, from which the
label is read (J. Lee et al., "Set Transformer", ICML 2019). The networks have some ten thousand
weights each. ``set_transformer_training`` trains them with PyTorch; they run with NumPy alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

__all__ = ["SetTransformer", "TransformerShape", "normalise", "standardise"]

Floats = NDArray[np.float32]

MAX_DEVIATIONS = 4.0
"""Values are clipped at this many standard deviations from their mean."""
MIN_SCALE = 1e-6
"""Least standard deviation that values are divided by."""
NORM_EPSILON = 1e-5
WIDENING = 2
"""Width of the layer within a block against that of a token."""
MAX_SIZE = 1024
"""Largest of the numbers that give a network its shape."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransformerShape:
    """Numbers of networks, of blocks and of heads in each, and the width of a token.

    ``n_profile`` and ``n_token`` are the lengths of the profile and of a token of the input;
    ``max_tokens`` of the longest contours count.
    """

    n_profile: int
    n_token: int
    n_classes: int
    n_networks: int = 1
    n_blocks: int = 2
    n_heads: int = 4
    width: int = 32
    max_tokens: int = 16

    def __post_init__(self) -> None:
        """Check that there can be such a network."""
        for name in self.__slots__:
            value, least = getattr(self, name), 0 if name == "n_profile" else 1
            if type(value) is not int or not least <= value <= MAX_SIZE:
                raise ValueError(f"{name} must be {least} to {MAX_SIZE}, got {value!r:.40}")
        if self.width % self.n_heads:
            raise ValueError(f"width must be a multiple of n_heads, {self.n_heads}")

    def weights(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array of weights, by name; its first axis is the network."""
        width, wide = self.width, WIDENING * self.width
        layers = {
            "profile": (self.n_profile, width),
            "token": (self.n_token, width),
            "out": (width, self.n_classes),
        }
        for k in range(self.n_blocks):
            layers |= {
                f"attend_{k}": (width, 3 * width),
                f"merge_{k}": (width, width),
                f"widen_{k}": (width, wide),
                f"narrow_{k}": (wide, width),
            }
        biases = {f"{name}_bias": (1, n) for name, (_, n) in layers.items()}
        return {name: (self.n_networks, *shape) for name, shape in (layers | biases).items()}


@dataclass(frozen=True, eq=False)
class SetTransformer:
    """Networks of one shape, whose mean logits count.

    ``weights`` are those of ``TransformerShape.weights``; ``means`` and ``scales``, each
    (n_profile + n_token,), standardise the values of profile and tokens.
    """

    shape: TransformerShape
    weights: Mapping[str, Floats]
    means: Floats
    scales: Floats

    def logits(self, profile: Floats, tokens: Floats) -> Floats:
        """Return the logits (n_classes,) of a view.

        Parameters
        ----------
        profile, tokens
            (n_profile,) and (C, n_token), the longest contour first; of more than ``max_tokens``
            contours the first count.
        """
        w, n = self.weights, self.shape.n_profile
        first = standardise(profile[None], self.means[:n], self.scales[:n])
        others = standardise(tokens[: self.shape.max_tokens], self.means[n:], self.scales[n:])
        x = np.concatenate(
            [first @ w["profile"] + w["profile_bias"], others @ w["token"] + w["token_bias"]],
            axis=1,
        )
        for k in range(self.shape.n_blocks):
            asked = normalise(x) @ w[f"attend_{k}"] + w[f"attend_{k}_bias"]
            x = x + _attend(asked, self.shape.n_heads) @ w[f"merge_{k}"] + w[f"merge_{k}_bias"]
            wide = np.maximum(normalise(x) @ w[f"widen_{k}"] + w[f"widen_{k}_bias"], 0.0)
            x = x + wide @ w[f"narrow_{k}"] + w[f"narrow_{k}_bias"]
        logits = normalise(x[:, :1]) @ w["out"] + w["out_bias"]
        return np.asarray(logits.mean(axis=(0, 1)))

    def arrays(self) -> dict[str, Floats]:
        """Return all arrays by name."""
        return {**self.weights, "means": self.means, "scales": self.scales}

    @classmethod
    def from_arrays(cls, shape: TransformerShape, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Restore networks; ``KeyError`` or ``ValueError`` if an array is not of that shape."""
        n_values = shape.n_profile + shape.n_token
        expected = {**shape.weights(), "means": (n_values,), "scales": (n_values,)}
        for name, wanted in expected.items():
            if arrays[name].shape != wanted:
                raise ValueError(f"constellation/{name} must be {wanted}, got {arrays[name].shape}")
        if (found := float(arrays["scales"].min())) < MIN_SCALE:
            raise ValueError(
                f"constellation/scales: found {found:g}, expected {MIN_SCALE:g} or more"
            )
        weights = {name: arrays[name] for name in shape.weights()}
        return cls(shape, weights, arrays["means"], arrays["scales"])


def standardise(values: Floats, means: Floats, scales: Floats) -> Floats:
    """Return values (..., D) in standard deviations from their means, clipped."""
    return np.asarray(np.clip((values - means) / scales, -MAX_DEVIATIONS, MAX_DEVIATIONS))


def normalise(x: Any) -> Any:
    """Return vectors (..., D), an array or a tensor, with mean 0 and variance 1."""
    centred = x - x.mean(-1)[..., None]
    return centred / ((centred * centred).mean(-1)[..., None] + NORM_EPSILON) ** 0.5


def _attend(x: Floats, n_heads: int) -> Floats:
    """Return what tokens gather (E, T, W) by their queries, keys and values (E, T, 3 W)."""
    n_networks, n_tokens, _ = x.shape
    query, key, value = x.reshape(n_networks, n_tokens, 3, n_heads, -1).transpose(2, 0, 3, 1, 4)
    scores = query @ key.swapaxes(2, 3) / np.sqrt(np.float32(key.shape[3]))
    gathered = softmax(scores, axis=3) @ value
    return np.asarray(gathered.swapaxes(1, 2).reshape(n_networks, n_tokens, -1))
