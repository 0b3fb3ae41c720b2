"""Training of a model: frames to descriptors, to words, idf and scene classifiers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import PlaceParams, TfIdf, Vocabulary, count_words, descriptors
from slam_bof.core import one_blas_thread
from slam_bof.errors import ModelError
from slam_bof.scenes.augmentation import remeasure
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.scenes.constellation_classifier import ConstellationClassifier
from slam_bof.scenes.folds import cut_segments
from slam_bof.scenes.frame_features import LevelledFeatures, levelled_features
from slam_bof.scenes.furniture_network import FurnitureNetwork
from slam_bof.scenes.levelled_classifier import LevelledClassifier, room_network
from slam_bof.scenes.model import Model
from slam_bof.scenes.set_transformer_training import TransformerTraining
from slam_bof.types import Array, DepthFrame

__all__ = [
    "FrameDescriptors",
    "TrainingFrame",
    "continue_model",
    "describe_frames",
    "fit_model",
    "train_model",
]


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrame:
    """A depth frame with its scene label, if it has one, and its sequence or room (``group``).

    Frames of one group are in the order of time. ``is_room`` says that the group is one of many
    rooms and must not be cut into segments. ``gravity_camera`` (3,), the direction of gravity
    in the camera frame, is needed for layers along gravity only.
    """

    frame: DepthFrame
    label: str | None = None
    group: str = ""
    gravity_camera: Array | None = None
    is_room: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FrameDescriptors:
    """The BOF descriptors of N training frames, and their levelled features.

    ``values`` (M, n_values) stack the descriptors of all frames, ``counts`` (N,) is their number
    in each frame. ``labels`` and ``groups`` have one entry a frame, and so has ``levelled``, which
    is empty where no levelled classifier is trained. ``copies`` has the features of each frame as
    other sensors would have measured it. ``are_rooms`` says whether groups are rooms, and
    ``furniture`` is the network that levelled features are from, if any.
    """

    values: NDArray[np.float32]
    counts: NDArray[np.intp]
    labels: tuple[str | None, ...]
    groups: tuple[str, ...]
    levelled: tuple[LevelledFeatures, ...] = ()
    copies: tuple[tuple[LevelledFeatures, ...], ...] = ()
    are_rooms: bool = False
    furniture: FurnitureNetwork | None = None

    def by_frame(self) -> list[NDArray[np.float32]]:
        """Return the descriptors of each of the N frames, (counts[k], n_values)."""
        return np.split(self.values, np.cumsum(self.counts)[:-1])

    def select(self, frames: Sequence[int]) -> FrameDescriptors:
        """Return the descriptors of some frames, by index, in that order."""
        by_frame = self.by_frame()
        return FrameDescriptors(
            values=np.concatenate([self.values[:0], *(by_frame[k] for k in frames)]),
            counts=self.counts[list(frames)],
            labels=tuple(self.labels[k] for k in frames),
            groups=tuple(self.groups[k] for k in frames),
            levelled=tuple(self.levelled[k] for k in frames) if self.levelled else (),
            copies=tuple(self.copies[k] for k in frames) if self.copies else (),
            are_rooms=self.are_rooms,
            furniture=self.furniture,
        )


def train_model(
    frames: Iterable[TrainingFrame],
    params: PlaceParams,
    *,
    n_words: int = 1024,
    seed: int = 0,
    trained_on: str,
    bag_classifier: SceneClassifier | None = None,
    levelled: bool = True,
    furniture: FurnitureNetwork | None = None,
    n_jobs: int | None = 1,
    on_frame: Callable[[int], None] | None = None,
) -> Model:
    """Train a model on frames; without labels of two classes it has no scene classifier.

    Parameters
    ----------
    frames
        The training frames; read once, one by one.
    params
        Parameters of layers, contours and BOF.
    n_words
        Number of words of the vocabulary.
    seed
        Seed of all random numbers.
    trained_on
        A description of the frames in words, for the model file.
    bag_classifier
        The classifier of bags to fit, by default a linear one with ``seed``.
    levelled
        Whether to train a levelled classifier too, which the model then prefers for its labels.
    furniture
        A furniture network for the levelled classifier, whose answers it then learns from too.
    n_jobs
        Number of frames described at a time; see ``describe_frames``.
    on_frame
        Called after each frame with the number of frames described so far.
    """
    described = describe_frames(
        frames, params, levelled=levelled, furniture=furniture, n_jobs=n_jobs, on_frame=on_frame
    )
    return fit_model(
        described,
        params,
        n_words=n_words,
        seed=seed,
        trained_on=trained_on,
        bag_classifier=bag_classifier,
    )


def describe_frames(
    frames: Iterable[TrainingFrame],
    params: PlaceParams,
    *,
    levelled: bool = False,
    with_tokens: bool = False,
    with_shapes: bool = False,
    furniture: FurnitureNetwork | None = None,
    n_copies: int = 0,
    seed: int = 0,
    n_jobs: int | None = 1,
    on_frame: Callable[[int], None] | None = None,
) -> FrameDescriptors:
    """Return the BOF descriptors of frames, and their levelled features where ``levelled``.

    ``with_tokens`` adds the tokens of a constellation classifier to these, and ``with_shapes``
    what a levelled classifier with shape words needs to be continued; ``furniture`` is the network
    of the classifier that they are for, if it has one.

    With ``n_copies`` there are levelled features of as many copies of each frame too, as other
    sensors, drawn by ``seed``, would have measured it. ``n_jobs`` frames are described at a time,
    each in a process of its own; None for that of the cluster of ``core.on_cluster``. The result
    does not depend on it.
    """
    values = [np.empty((0, params.bof.n_values), np.float32)]
    labels: list[str | None] = []
    groups: list[str] = []
    features: list[LevelledFeatures] = []
    copies: list[tuple[LevelledFeatures, ...]] = []
    are_rooms = True
    rng = np.random.default_rng(seed)

    def jobs() -> Iterator[Any]:
        """Random numbers run on from frame to frame, so copies are made here."""
        nonlocal are_rooms
        for item in frames:
            labels.append(item.label)
            groups.append(item.group)
            are_rooms &= item.is_room
            views = [(item.frame, item.gravity_camera)]
            views += [remeasure(item.frame, rng, item.gravity_camera) for _ in range(n_copies)]
            yield joblib.delayed(_describe_frame)(
                views,
                params,
                levelled=levelled,
                with_tokens=with_tokens,
                with_shapes=with_shapes,
                furniture=furniture,
            )

    described = joblib.Parallel(n_jobs=n_jobs, return_as="generator")(jobs())
    for n_done, (of_frame, of_views) in enumerate(described, start=1):
        values.append(of_frame)
        if levelled:
            features.append(of_views[0])
            copies.append(of_views[1:])
        if on_frame is not None:
            on_frame(n_done)
    return FrameDescriptors(
        values=np.concatenate(values),
        counts=np.array([len(of_frame) for of_frame in values[1:]], np.intp),
        labels=tuple(labels),
        groups=tuple(groups),
        levelled=tuple(features),
        copies=tuple(copies),
        are_rooms=are_rooms,
        furniture=furniture,
    )


@one_blas_thread()
def _describe_frame(
    views: Sequence[tuple[DepthFrame, Array | None]],
    params: PlaceParams,
    *,
    levelled: bool,
    with_tokens: bool,
    with_shapes: bool,
    furniture: FurnitureNetwork | None,
) -> tuple[NDArray[np.float32], tuple[LevelledFeatures, ...]]:
    """Return the BOF descriptors of a frame, and the levelled features of it and its copies."""
    frame, gravity_camera = views[0]
    return (
        descriptors(frame, params, gravity_camera=gravity_camera),
        tuple(
            levelled_features(
                view,
                gravity_camera=down,
                with_shapes=with_shapes,
                with_tokens=with_tokens,
                furniture=furniture,
            )
            for view, down in views
            if levelled
        ),
    )


def fit_model(
    described: FrameDescriptors,
    params: PlaceParams,
    *,
    n_words: int = 1024,
    seed: int = 0,
    trained_on: str,
    bag_classifier: SceneClassifier | None = None,
    constellation: bool = False,
) -> Model:
    """Fit vocabulary, idf and scene classifiers to descriptors.

    With ``constellation``, which needs PyTorch and features with tokens, a classifier of
    constellations is among them. Probabilities are calibrated on sequences (groups) held out from
    training, or on segments of sequences where few sequences show a class (``cut_segments``).
    Parameters are those of ``train_model``.

    Raises
    ------
    PluginError
        If PyTorch is needed and not installed.
    ValueError
        If there are fewer descriptors than words.
    """
    vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(described.values)
    words = np.split(vocabulary.labels_, np.cumsum(described.counts)[:-1])
    counts = count_words(words, n_words)
    tf_idf = TfIdf().fit(counts)
    labelled = np.array([label is not None for label in described.labels])
    labels = np.array([label for label in described.labels if label is not None])
    fitted_classifier = levelled_classifier = constellation_classifier = None
    if len(set(labels.tolist())) > 1:
        bags = tf_idf.transform(counts)[labelled]
        sequences = list(compress(described.groups, labelled))
        groups = sequences if described.are_rooms else cut_segments(labels.tolist(), sequences)
        n_groups = len(set(groups)) if groups != sequences else None
        fitted_classifier = (bag_classifier or SceneClassifier(seed=seed)).fit(bags, labels, groups)
        if described.levelled:
            features = list(compress(described.levelled, labelled))
            levelled_classifier = LevelledClassifier.fit(
                features,
                labels.tolist(),
                groups,
                n_groups=n_groups,
                copies=list(compress(described.copies, labelled)),
                weights=np.ones(len(labels)) if described.are_rooms else None,
                network=room_network(seed) if described.are_rooms else None,
                furniture=described.furniture,
                seed=seed,
            )
        if constellation:
            constellation_classifier = ConstellationClassifier.fit(
                list(compress(described.levelled, labelled)),
                labels.tolist(),
                groups,
                copies=list(compress(described.copies, labelled)),
                training=TransformerTraining(seed=seed),
            )
    return Model(
        places=params,
        vocabulary=vocabulary,
        tf_idf=tf_idf,
        bag_classifier=fitted_classifier,
        trained_on=trained_on,
        levelled_classifier=levelled_classifier,
        constellation_classifier=constellation_classifier,
    )


def continue_model(model: Model, described: FrameDescriptors, *, trained_on: str) -> Model:
    """Continue the training of a model's levelled classifier with labelled frames.

    Words and idf stay. There is no classifier of bags or constellations in what results: they
    cannot be continued without the frames that they were trained with.

    Raises
    ------
    ModelError
        If the model has no levelled classifier.
    """
    if model.levelled_classifier is None:
        raise ModelError(
            f"the model ({model.trained_on}): found no levelled classifier, expected "
            "one to continue"
        )
    labelled = [label is not None for label in described.labels]
    classifier = model.levelled_classifier.continue_training(
        list(compress(described.levelled, labelled)),
        [label for label in described.labels if label is not None],
        copies=list(compress(described.copies, labelled)),
    )
    return replace(
        model,
        bag_classifier=None,
        levelled_classifier=classifier,
        constellation_classifier=None,
        trained_on=f"{model.trained_on}; continued with {trained_on}",
    )
