"""The scene label of a single depth image file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slam_bof.datasets import read_depth_image
from slam_bof.errors import ModelError
from slam_bof.scenes.hmm_filter import LabelledBy, most_probable_scene
from slam_bof.scenes.model import Model
from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["ImageLabel", "label_image"]


@dataclass(frozen=True, slots=True)
class ImageLabel:
    """The label of a depth image; ``probabilities`` by label, most probable first.

    ``label`` is "unknown" where the most probable label is less probable than ``min_probability``.
    ``intrinsics_from`` states the source of the intrinsics in words.
    """

    image: str
    label: str
    probability: float
    probabilities: dict[str, float]
    intrinsics: Intrinsics
    intrinsics_from: str


def label_image(
    path: Path,
    model: Model,
    *,
    intrinsics: Sequence[float] | None = None,
    depth_scale: float | None = None,
    min_probability: float = 0.0,
) -> ImageLabel:
    """Label a depth image file.

    Parameters
    ----------
    path, intrinsics, depth_scale
        The file and its camera; see ``slam_bof.datasets.read_depth_image``.
    model
        A model trained with labels.
    min_probability
        Least probability of a label; below it the label is "unknown".

    Raises
    ------
    DatasetError
        If the image or its intrinsics cannot be read.
    ModelError
        If the model was trained without labels.
    """
    frame, source = read_depth_image(path, intrinsics=intrinsics, depth_scale=depth_scale)
    return label_frame(frame, model, name=str(path), source=source, min_probability=min_probability)


def label_frame(
    frame: DepthFrame,
    model: Model,
    *,
    name: str,
    source: str,
    min_probability: float = 0.0,
    by: LabelledBy = "levelled",
) -> ImageLabel:
    """Label a depth frame; ``name`` and ``source`` say where it and its intrinsics are from.

    ``by`` is that of ``Model.labeller``. Other parameters are those of ``label_image``.
    """
    labeller = model.labeller(by)
    if labeller is None:
        raise ModelError(f"the model ({model.trained_on}): found no labels, expected some")
    scene = labeller.label(frame)
    best = most_probable_scene(scene.probabilities, scene.classes, min_probability)
    pairs = zip(scene.classes, scene.probabilities.tolist(), strict=True)
    return ImageLabel(
        image=name,
        label=best.label,
        probability=best.probability,
        probabilities=dict(sorted(pairs, key=lambda pair: -pair[1])),
        intrinsics=frame.intrinsics,
        intrinsics_from=source,
    )
