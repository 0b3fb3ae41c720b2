"""Training of set transformers with PyTorch, which only this module needs (extra ``train``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.errors import PluginError
from slam_bof.scenes.set_transformer import (
    MIN_SCALE,
    SetTransformer,
    TransformerShape,
    normalise,
    standardise,
)

__all__ = ["TransformerTraining", "View", "fit_transformer", "import_torch", "transformer_logits"]

Floats = NDArray[np.float32]
View = tuple[Floats, Floats]
"""Profile (n_profile,) and tokens (C, n_token) of a view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransformerTraining:
    """How networks are trained: AdamW on batches drawn by the samples' weights.

    ``dropout`` is the share of values, ``token_dropout`` that of whole tokens that a batch leaves
    out; ``smoothing`` the probability that is dealt out to all classes.
    """

    n_steps: int = 400
    batch_size: int = 64
    learning_rate: float = 2e-3
    decay: float = 0.05
    dropout: float = 0.2
    token_dropout: float = 0.2
    smoothing: float = 0.05
    seed: int = 0


def import_torch() -> Any:
    """Return PyTorch, limited to one thread, so that the same seed gives the same weights."""
    try:
        import torch
    except ImportError as error:
        raise PluginError(
            "a set transformer: found no torch to train it with; pip install 'slam-bof[train]'"
        ) from error
    torch.set_num_threads(1)
    return torch


def fit_transformer(
    views: Sequence[View],
    y: ArrayLike,
    shape: TransformerShape,
    training: TransformerTraining | None = None,
    *,
    weights: ArrayLike | None = None,
    start: SetTransformer | None = None,
) -> SetTransformer:
    """Train networks.

    Parameters
    ----------
    views, y
        N views, and the number (N,) of the class of each.
    shape, training
        What networks to train, and how.
    weights
        (N,) weight of each view; by default equal.
    start
        Networks of that shape to start from, instead of random ones.

    Raises
    ------
    PluginError
        If PyTorch is not installed.
    """
    torch, training = import_torch(), training or TransformerTraining()
    generator = torch.Generator().manual_seed(training.seed)
    if start is None:
        means, scales = _statistics(views, shape)
        start = SetTransformer(shape, _random_weights(shape, training.seed), means, scales)
    w = {k: torch.tensor(a, requires_grad=True) for k, a in start.weights.items()}
    profiles, tokens, known = _tensors(torch, views, start)
    classes = torch.from_numpy(np.asarray(y, np.int64))
    probability = np.ones(len(views)) if weights is None else np.asarray(weights, np.float64)
    drawn = torch.from_numpy(probability / probability.sum())
    groups = [
        {"params": [v for k, v in w.items() if not k.endswith("bias")]},
        {"params": [v for k, v in w.items() if k.endswith("bias")], "weight_decay": 0.0},
    ]
    rate, n_steps = training.learning_rate, training.n_steps
    optimizer = torch.optim.AdamW(groups, lr=rate, weight_decay=training.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, n_steps, pct_start=0.1)

    def drop(x: Any, share: float = training.dropout) -> Any:
        return x * (torch.rand(x.shape, generator=generator) >= share) / (1.0 - share)

    for _ in range(n_steps):
        rows = torch.multinomial(drawn, training.batch_size, True, generator=generator)
        kept = known[rows] & (drop(torch.ones(known[rows].shape), training.token_dropout) > 0)
        logits = _forward(torch, shape, w, profiles[rows], tokens[rows], kept, drop)
        loss = torch.nn.functional.cross_entropy(
            logits.flatten(0, 1),
            classes[rows].repeat(shape.n_networks),
            label_smoothing=training.smoothing,
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    learnt = {name: v.detach().numpy() for name, v in w.items()}
    return SetTransformer(shape, learnt, start.means, start.scales)


def transformer_logits(network: SetTransformer, views: Sequence[View]) -> Floats:
    """Return the logits (N, n_classes) of N views by PyTorch, faster than one by one."""
    torch = import_torch()
    w = {name: torch.from_numpy(array) for name, array in network.weights.items()}
    out = [np.zeros((0, network.shape.n_classes), np.float32)]
    with torch.no_grad():
        for first in range(0, len(views), 256):
            profiles, tokens, known = _tensors(torch, views[first : first + 256], network)
            logits = _forward(torch, network.shape, w, profiles, tokens, known, lambda x: x)
            out.append(logits.mean(0).numpy())
    return np.concatenate(out)


def _forward(
    torch: Any,
    shape: TransformerShape,
    w: dict[str, Any],
    profiles: Any,
    tokens: Any,
    known: Any,
    drop: Any,
) -> Any:
    """Return the logits (E, B, n_classes) of a batch; ``SetTransformer.logits`` of one view.

    ``known`` (B, T) says which of the tokens (B, T, n_token) there are.
    """
    n_views, n_tokens = known.shape
    networks, width, n = shape.n_networks, shape.width, n_tokens + 1
    first = drop(profiles)[None] @ w["profile"] + w["profile_bias"]
    others = tokens.reshape(1, n_views * n_tokens, -1) @ w["token"] + w["token_bias"]
    x = torch.cat([first[:, :, None], others.reshape(networks, n_views, n_tokens, width)], 2)
    x = x.reshape(networks, n_views * n, width)
    mask = torch.cat([torch.ones_like(known[:, :1]), known], 1)[:, None, None]
    for k in range(shape.n_blocks):
        asked = normalise(x) @ w[f"attend_{k}"] + w[f"attend_{k}_bias"]
        query, key, value = asked.reshape(networks * n_views, n, 3, shape.n_heads, -1).permute(
            2, 0, 3, 1, 4
        )
        gathered = torch.nn.functional.scaled_dot_product_attention(
            query, key, value, attn_mask=mask.repeat(networks, 1, 1, 1)
        )
        gathered = gathered.transpose(1, 2).reshape(networks, n_views * n, width)
        x = x + drop(gathered @ w[f"merge_{k}"] + w[f"merge_{k}_bias"])
        wide = torch.relu(normalise(x) @ w[f"widen_{k}"] + w[f"widen_{k}_bias"])
        x = x + drop(wide @ w[f"narrow_{k}"] + w[f"narrow_{k}_bias"])
    pooled = normalise(x.reshape(networks, n_views, n, width)[:, :, 0])
    return drop(pooled) @ w["out"] + w["out_bias"]


def _random_weights(shape: TransformerShape, seed: int) -> dict[str, Floats]:
    """Return normal weights that keep the variance of their inputs, and biases of zero."""
    rng = np.random.default_rng(seed)
    return {
        name: np.zeros(size, np.float32)
        if name.endswith("bias")
        else rng.standard_normal(size, np.float32) / np.float32(max(size[1], 1) ** 0.5)
        for name, size in shape.weights().items()
    }


def _statistics(views: Sequence[View], shape: TransformerShape) -> tuple[Floats, Floats]:
    """Return means and standard deviations (n_profile + n_token,) of profiles and tokens."""
    profiles = np.array([profile for profile, _ in views])
    tokens = np.concatenate([tokens[: shape.max_tokens] for _, tokens in views])
    if not len(tokens):
        tokens = np.zeros((1, shape.n_token), np.float32)
    means = np.concatenate([profiles.mean(0), tokens.mean(0)])
    scales = np.concatenate([profiles.std(0), tokens.std(0)])
    return means, np.where(scales < MIN_SCALE, 1.0, scales).astype(np.float32)


def _tensors(torch: Any, views: Sequence[View], network: SetTransformer) -> tuple[Any, ...]:
    """Return standardised profiles (N, n_profile), tokens (N, T, n_token), and which are known."""
    n, shape = network.shape.n_profile, network.shape
    padded = np.zeros((len(views), shape.max_tokens, shape.n_token), np.float32)
    known = np.zeros(padded.shape[:2], bool)
    for k, (_, tokens) in enumerate(views):
        kept = tokens[: shape.max_tokens]
        padded[k, : len(kept)], known[k, : len(kept)] = kept, True
    profiles = np.array([profile for profile, _ in views], np.float32)
    profiles = standardise(profiles, network.means[:n], network.scales[:n])
    padded = standardise(padded, network.means[n:], network.scales[n:])
    return torch.from_numpy(profiles), torch.from_numpy(padded), torch.from_numpy(known)
