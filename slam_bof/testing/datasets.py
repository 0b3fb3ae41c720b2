"""The contract of data-set plug-ins, as a test."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from slam_bof.errors import DatasetError
from slam_bof.ports import Dataset, DatasetFormat
from slam_bof.testing.scenery import expect, expect_rigid
from slam_bof.types import DepthFrame, Params

__all__ = ["check_dataset"]


def check_dataset(plugin: Any, path: Path, params: Params | None = None) -> None:
    """Check that a data-set plug-in keeps the contracts of ``DatasetFormat`` and ``Dataset``.

    The format must recognise a small sequence of yours at ``path``, but not an empty folder, which
    ``open`` must refuse by a ``DatasetError`` of one line. In the sequence, timestamps must
    strictly increase, a frame read twice must be the same, and images, ground truth and labels
    must fit the frames.

    Parameters
    ----------
    plugin
        The plug-in: a ``slam_bof.ports.DatasetFormat``, usually a class.
    path
        Path of a sequence with at least one frame.
    params
        Options, for a plug-in that takes any.

    Raises
    ------
    AssertionError
        If the plug-in breaks a contract; the message says which.
    """
    _check_format(plugin, path, params)
    dataset = plugin.open(path) if params is None else plugin.open(path, params)
    expect(isinstance(dataset, Dataset), "it must have all that slam_bof.ports.Dataset has")
    expect(bool(dataset.sequence), "sequence must say which one it is")
    expect(len(dataset) > 0, "there must be frames")
    frames = [_check_frame(dataset, index) for index in range(len(dataset))]
    stamps_s = np.array([frame.stamp_s for frame in frames])
    expect(bool((np.diff(stamps_s) > 0).all()), "timestamps must strictly increase")
    _check_truths(dataset)


def _check_format(plugin: Any, path: Path, params: Params | None) -> None:
    expect(
        isinstance(plugin, DatasetFormat), "it must have all that slam_bof.ports.DatasetFormat has"
    )
    expect(bool(plugin.recognises(path)), f"recognises({path}) must be true")
    with tempfile.TemporaryDirectory() as empty:
        expect(not plugin.recognises(Path(empty)), "an empty folder must not be recognised")
        arguments = () if params is None else (params,)
        try:
            plugin.open(Path(empty), *arguments)
        except DatasetError as error:
            expect("\n" not in str(error), "a DatasetError must be one line")
            expect(empty in str(error), "a DatasetError must name the folder or file")
        else:
            expect(False, "open of an empty folder must raise DatasetError")


def _check_frame(dataset: Dataset, index: int) -> DepthFrame:
    frame, again = dataset.frame(index), dataset.frame(index)
    expect(isinstance(frame, DepthFrame), f"frame({index}) must be a DepthFrame")
    expect(bool(np.isfinite(frame.stamp_s)), f"the stamp of frame {index} must be finite")
    expect(
        frame.stamp_s == again.stamp_s and np.array_equal(frame.depth, again.depth, equal_nan=True),
        f"frame {index} read twice must be the same",
    )
    images = (("color", dataset.color(index), 3), ("gray", dataset.gray(index), 2))
    for what, image, n_axes in images:
        if image is not None:
            expect(
                image.dtype == np.uint8 and image.ndim == n_axes,
                f"{what}({index}) must be uint8 with {n_axes} axes, got {image.dtype}, "
                f"{image.shape}",
            )
    return frame


def _check_truths(dataset: Dataset) -> None:
    truth = dataset.groundtruth()
    if truth is not None:
        expect(len(truth) == len(dataset), "ground truth must have a pose for each frame, NaN too")
        for index, T in enumerate(truth.poses):
            if not np.isnan(T).any():
                expect_rigid(T, f"the true pose of frame {index}")
    scenes = dataset.scenes()
    expect(scenes is None or len(scenes) == len(dataset), "scenes must have a label for each frame")
