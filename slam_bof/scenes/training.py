"""Training of a model: frames to descriptors to words, idf and scene classifier."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import PlaceParams, TfIdf, Vocabulary, count_words, descriptors
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.scenes.folds import cut_stretches
from slam_bof.scenes.levelled_classifier import LevelledView, LevelScenes, look
from slam_bof.scenes.model import Model
from slam_bof.types import Array, DepthFrame

__all__ = ["Descriptors", "TrainingFrame", "describe_frames", "fit_model", "train_model"]


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrame:
    """A depth frame with its scene label, if it has one, and the sequence it comes from.

    Frames of one ``group`` are in the order of time.
    ``gravity_camera`` (3,), the direction down, is needed for layers along gravity only.
    """

    frame: DepthFrame
    label: str | None = None
    group: str = ""
    gravity_camera: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Descriptors:
    """The descriptors of all training frames.

    ``values`` (M, n_values) stack those of each frame in turn; ``counts`` (N,) says how many
    each frame has; ``labels`` and ``groups`` are of the N frames, and ``views``, where levelled
    views are to be labelled.
    """

    values: NDArray[np.float32]
    counts: NDArray[np.intp]
    labels: tuple[str | None, ...]
    groups: tuple[str, ...]
    views: tuple[LevelledView, ...] = ()

    def of_frames(self) -> list[NDArray[np.float32]]:
        """Return the descriptors of each of the N frames, (counts[k], n_values)."""
        return np.split(self.values, np.cumsum(self.counts)[:-1])

    def select(self, frames: Sequence[int]) -> Descriptors:
        """Return those of some frames, by number, in that order."""
        parts = self.of_frames()
        return Descriptors(
            np.concatenate([self.values[:0], *(parts[k] for k in frames)]),
            self.counts[list(frames)],
            tuple(self.labels[k] for k in frames),
            tuple(self.groups[k] for k in frames),
            tuple(self.views[k] for k in frames) if self.views else (),
        )


def train_model(
    frames: Iterable[TrainingFrame],
    params: PlaceParams,
    *,
    n_words: int = 1024,
    seed: int = 0,
    trained_on: str,
    scenes: SceneClassifier | None = None,
    levelled: bool = True,
    on_frame: Callable[[int], None] | None = None,
) -> Model:
    """Train a model of frames; without labels of two classes it has no scene classifier.

    Parameters
    ----------
    frames
        Read once, one by one.
    trained_on
        What the frames are, in words, for the model file.
    scenes
        The classifier of bags to fit, by default a linear one with ``seed``.
    levelled
        Whether the model learns to label levelled views too, which it then prefers to bags.
    on_frame
        Called with the number of frames described so far, after each.
    """
    described = describe_frames(frames, params, levelled=levelled, on_frame=on_frame)
    return fit_model(
        described, params, n_words=n_words, seed=seed, trained_on=trained_on, scenes=scenes
    )


def describe_frames(
    frames: Iterable[TrainingFrame],
    params: PlaceParams,
    *,
    levelled: bool = False,
    on_frame: Callable[[int], None] | None = None,
) -> Descriptors:
    """Return the BOF descriptors of frames, and what they show levelled if that is asked for."""
    values = [np.empty((0, params.bof.n_values), np.float32)]
    labels: list[str | None] = []
    groups: list[str] = []
    views: list[LevelledView] = []
    for n_done, item in enumerate(frames, start=1):
        values.append(descriptors(item.frame, params, gravity_camera=item.gravity_camera))
        labels.append(item.label)
        groups.append(item.group)
        if levelled:
            views.append(look(item.frame, gravity_camera=item.gravity_camera))
        if on_frame is not None:
            on_frame(n_done)
    counts = np.array([len(part) for part in values[1:]], np.intp)
    return Descriptors(np.concatenate(values), counts, tuple(labels), tuple(groups), tuple(views))


def fit_model(
    described: Descriptors,
    params: PlaceParams,
    *,
    n_words: int = 1024,
    seed: int = 0,
    trained_on: str,
    scenes: SceneClassifier | None = None,
) -> Model:
    """Fit words, idf and the scene classifier (``scenes``, or the default) to descriptors.

    How sure to be is learnt from sequences (groups) held out; of classes that few of them show,
    from stretches of these, for what is seen a moment before or after is no test.

    Raises
    ------
    ValueError
        If there are fewer descriptors than words.
    """
    vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(described.values)
    words = np.split(vocabulary.labels_, np.cumsum(described.counts)[:-1])
    counts = count_words(words, n_words)
    tf_idf = TfIdf().fit(counts)
    labelled = np.array([label is not None for label in described.labels])
    labels = np.array([label for label in described.labels if label is not None])
    fitted = levels = None
    if len(set(labels.tolist())) > 1:
        bags = tf_idf.transform(counts)[labelled]
        sequences = list(compress(described.groups, labelled))
        groups = cut_stretches(labels.tolist(), sequences)
        n_moments = len(set(groups)) if groups != sequences else None
        fitted = (scenes or SceneClassifier(seed=seed)).fit(bags, labels, groups)
        if described.views:
            views = list(compress(described.views, labelled))
            levels = LevelScenes.learn(
                views, labels.tolist(), groups, n_moments=n_moments, seed=seed
            )
    return Model(params, vocabulary, tf_idf, fitted, trained_on, levels)
