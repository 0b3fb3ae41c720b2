"""Training of a furniture network with PyTorch, which only this module needs (extra ``train``)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.scenes.furniture_network import (
    CELL_PX,
    DILATIONS,
    IMAGE_SHAPE,
    KERNELS,
    MIN_WEIGHT,
    STRIDES,
    WIDTHS,
    FurnitureNetwork,
    furniture_image,
)
from slam_bof.scenes.levelled_cloud import levelled_cloud
from slam_bof.scenes.set_transformer_training import import_torch
from slam_bof.types import Array, DepthFrame

__all__ = ["FurnitureTraining", "FurnitureView", "fit_furniture", "furniture_view"]

UNLABELLED = 255
"""Label of cells beyond the image, which do not count."""


@dataclass(frozen=True, slots=True, eq=False)
class FurnitureView:
    """What a network learns from a view: its image, the furniture of each cell, and its room.

    ``image`` is of ``IMAGE_SHAPE`` in half precision, ``pieces`` (h, w) of its cells, the number of
    the kind of furniture in the middle of each.
    """

    image: NDArray[np.float16]
    pieces: NDArray[np.uint8]
    room: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FurnitureTraining:
    """How a network is trained: AdamW with one cycle of the learning rate, views mirrored or not.

    The loss is the cross entropy of the furniture of cells, and ``room_weight`` times that of the
    kind of room, of which ``smoothing`` is dealt out to all kinds and ``dropout`` left out.
    """

    n_epochs: int = 24
    batch_size: int = 48
    learning_rate: float = 3e-3
    decay: float = 0.02
    room_weight: float = 0.5
    smoothing: float = 0.05
    dropout: float = 0.3
    seed: int = 0


def furniture_view(
    frame: DepthFrame, pieces: NDArray[np.uint8], room: int, *, gravity_camera: Array | None
) -> FurnitureView:
    """Return what a network learns from a frame, of whose pixels ``pieces`` (H, W) is known."""
    cloud = levelled_cloud(frame, gravity_camera=gravity_camera)
    rows, columns = cloud.grid_points.shape[:2]
    stride = -(-frame.intrinsics.height // rows)
    of_grid = pieces[::stride, ::stride][: IMAGE_SHAPE[1], : IMAGE_SHAPE[2]]
    if pieces[::stride, ::stride].shape != (rows, columns):
        raise ValueError(f"pieces must be those of a frame's pixels, got {pieces.shape}")
    labels = np.full(IMAGE_SHAPE[1:], UNLABELLED, np.uint8)
    labels[: of_grid.shape[0], : of_grid.shape[1]] = of_grid
    middle = slice((CELL_PX - 1) // 2, None, CELL_PX)
    return FurnitureView(furniture_image(cloud).astype(np.float16), labels[middle, middle], room)


def fit_furniture(
    views: Iterable[FurnitureView],
    n_pieces: int,
    n_rooms: int,
    training: FurnitureTraining | None = None,
    *,
    on_epoch: Callable[[int], None] = lambda done: None,
) -> FurnitureNetwork:
    """Train a network on views of rooms whose furniture is known.

    Parameters
    ----------
    views
        The views.
    n_pieces, n_rooms
        Numbers of kinds of furniture and of rooms.
    training
        How to train.
    on_epoch
        Called after each pass over the views with the number of passes.

    Raises
    ------
    PluginError
        If PyTorch is not installed.
    """
    torch, training = import_torch(), training or FurnitureTraining()
    items = list(views)
    images = np.array([item.image for item in items])
    pieces = np.array([item.pieces for item in items])
    rooms = np.array([item.room for item in items])
    torch.manual_seed(training.seed)
    rng = np.random.default_rng(training.seed)
    layers = _layers(torch, n_pieces, n_rooms)
    optimizer = torch.optim.AdamW(layers.parameters(), weight_decay=training.decay)
    n_batches = max(len(items) // training.batch_size, 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, training.learning_rate, total_steps=training.n_epochs * n_batches
    )
    functions = torch.nn.functional
    for epoch in range(training.n_epochs):
        order = rng.permutation(len(items))
        for k in range(n_batches):
            batch = order[k * training.batch_size : (k + 1) * training.batch_size]
            inputs = torch.tensor(images[batch].astype(np.float32))
            cells = torch.tensor(pieces[batch].astype(np.int64))
            if rng.random() < 0.5:
                inputs, cells = inputs.flip(3), cells.flip(2)
            of_cells, of_rooms = _outputs(torch, layers, inputs, training.dropout)
            loss = functions.cross_entropy(of_cells, cells, ignore_index=UNLABELLED)
            loss = loss + training.room_weight * functions.cross_entropy(
                of_rooms, torch.tensor(rooms[batch]), label_smoothing=training.smoothing
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        on_epoch(epoch + 1)
    return _network(layers)


def _layers(torch: Any, n_pieces: int, n_rooms: int) -> Any:
    """Return the layers of a network, each convolution with its normalisation by batches."""
    layers, n_channels = torch.nn.ModuleDict(), IMAGE_SHAPE[0]
    for k, (width, size, stride, dilation) in enumerate(
        zip(WIDTHS, KERNELS, STRIDES, DILATIONS, strict=True)
    ):
        layers[f"convolution_{k}"] = torch.nn.Conv2d(
            n_channels, width, size, stride, dilation * (size // 2), dilation
        )
        layers[f"norm_{k}"] = torch.nn.BatchNorm2d(width)
        n_channels = width
    layers["piece"] = torch.nn.Conv2d(n_channels, n_pieces, 1)
    layers["room"] = torch.nn.Linear(2 * n_channels, n_rooms)
    return layers


def _outputs(torch: Any, layers: Any, inputs: Any, dropout: float) -> tuple[Any, Any]:
    """Return the logits of cells (N, n_pieces, h, w) and of rooms (N, n_rooms)."""
    functions = torch.nn.functional
    known = functions.avg_pool2d(inputs[:, 4:5], CELL_PX)
    for k in range(len(WIDTHS)):
        inputs = functions.relu(layers[f"norm_{k}"](layers[f"convolution_{k}"](inputs)))
    mean = (inputs * known).sum((2, 3)) / (known.sum((2, 3)) + MIN_WEIGHT)
    pooled = torch.cat([mean, (inputs * (known > 0)).amax((2, 3))], 1)
    return layers["piece"](inputs), layers["room"](functions.dropout(pooled, dropout))


def _network(layers: Any) -> FurnitureNetwork:
    """Return the network of trained layers, with normalisations taken into the convolutions."""
    weights = {}
    for k in range(len(WIDTHS)):
        convolution, norm = layers[f"convolution_{k}"], layers[f"norm_{k}"]
        scale = norm.weight / (norm.running_var + norm.eps).sqrt()
        weights[f"kernel_{k}"] = convolution.weight * scale[:, None, None, None]
        weights[f"bias_{k}"] = (convolution.bias - norm.running_mean) * scale + norm.bias
    weights |= {"piece": layers["piece"].weight[:, :, 0, 0], "piece_bias": layers["piece"].bias}
    weights |= {"room": layers["room"].weight, "room_bias": layers["room"].bias}
    return FurnitureNetwork(**{name: w.detach().numpy().copy() for name, w in weights.items()})
