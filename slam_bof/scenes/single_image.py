"""The scene of a single depth image, by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from slam_bof.datasets import read_depth_image
from slam_bof.errors import ModelError
from slam_bof.scenes.hmm_filter import decide
from slam_bof.scenes.model import Model
from slam_bof.types import Intrinsics

__all__ = ["ImageLabel", "label_image"]


@dataclass(frozen=True, slots=True)
class ImageLabel:
    """What a model says of a depth image; ``probabilities`` by label, most likely first.

    ``label`` is "unknown" where the most likely one is less probable than was asked for.
    ``intrinsics_from`` says in words where the intrinsics are from.
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
    """Label a depth image file, read as ``images.read_depth_image`` does.

    Parameters
    ----------
    path, intrinsics, depth_scale
        The file and its camera, as there.
    model
        Trained with labels.
    min_probability
        Below it the label is "unknown".

    Raises
    ------
    DatasetError
        As there.
    ModelError
        If the model was trained without labels.
    """
    labeller = model.labeller()
    if labeller is None:
        raise ModelError(f"the model ({model.trained_on}): found no labels, expected some")
    frame, source = read_depth_image(path, intrinsics=intrinsics, depth_scale=depth_scale)
    scene = labeller.label(frame)
    decided = decide(scene.probabilities, scene.classes, min_probability)
    pairs = zip(scene.classes, scene.probabilities.tolist(), strict=True)
    return ImageLabel(
        str(path),
        decided.label,
        decided.probability,
        dict(sorted(pairs, key=lambda pair: -pair[1])),
        frame.intrinsics,
        source,
    )
