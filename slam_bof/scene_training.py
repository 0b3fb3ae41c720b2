"""Train a model on labelled frames, and check it on frames held out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slam_bof.errors import DatasetError
from slam_bof.labelled import LabelledFrame, moments, sequence_names
from slam_bof.machines import Found, MachineName, search_svm
from slam_bof.model import Model
from slam_bof.places import PlaceParams
from slam_bof.scene_scores import SceneScores, score
from slam_bof.scene_splits import Split, split_by_time
from slam_bof.scenes import SceneClassifier
from slam_bof.training import TrainingFrame, describe_frames, fit_model, train_model
from slam_bof.types import Array

__all__ = ["TrainedScenes", "judge_model", "train_scenes"]

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class TrainedScenes:
    """A model, and how good one trained the same way is on frames held out.

    ``scores`` is None where that was not asked for, ``found`` where there was no grid search.
    """

    model: Model
    scores: SceneScores | None
    found: Found | None
    n_checked: int


def train_scenes(
    frames: Sequence[LabelledFrame],
    params: PlaceParams | None = None,
    *,
    trained_on: str,
    n_words: int = 1024,
    levelled: bool = True,
    classifier: MachineName | None = None,
    grid_search: bool = False,
    check: bool = True,
    seed: int = 0,
    on_progress: Progress = lambda what, done, total: None,
) -> TrainedScenes:
    """Train a model on all frames.

    Parameters
    ----------
    frames
        Of at least two classes.
    params
        How frames become descriptors.
    trained_on
        What the frames are, in words, for the model file.
    n_words
        Of the vocabulary.
    levelled
        Label levelled views, the product's way; without, bags of words, the paper's.
    classifier
        One of ``machines.MACHINES`` on bags of words; by default a linear support vector machine.
    grid_search
        Choose a support vector machine on bags, linear or Gaussian, and its parameters, by
        cross-validation.
    check
        First train on the beginning of every sequence and test on its end (``split_by_time``).
    seed
        Of all that is random.
    on_progress
        Called with what is done, how much of it is, and of how much.

    Raises
    ------
    DatasetError
        If there are fewer than two classes, too few frames to test with, or the frames show less
        than the vocabulary has words.
    """
    params = params or PlaceParams()
    split = split_by_time(frames) if check else Split(list(frames), list(frames))
    split.check()
    scenes = None if classifier is None else SceneClassifier(machine=classifier, seed=seed)
    found = None
    if grid_search:
        found = _search(split.train, params, n_words, seed, on_progress)
        scenes = SceneClassifier(machine=found.name, C=found.C, gamma=found.gamma, seed=seed)

    def train(part: Sequence[LabelledFrame], what: str) -> Model:
        try:
            return train_model(
                _read(part, what, on_progress),
                params,
                n_words=n_words,
                seed=seed,
                trained_on=trained_on,
                scenes=scenes,
                levelled=levelled,
            )
        except ValueError as error:
            raise DatasetError(f"cannot train on {len(part)} frames: {error}") from error

    scores = None
    if check:
        scores = judge_model(train(split.train, "Checking"), split.test, on_progress=on_progress)
    model = train(frames, "Training")
    return TrainedScenes(model, scores, found, len(split.test) if check else 0)


def judge_model(
    model: Model,
    frames: Sequence[LabelledFrame],
    *,
    on_progress: Progress = lambda what, done, total: None,
) -> SceneScores:
    """Judge a model by frames with labels; those of classes it does not know count as wrong.

    Raises
    ------
    DatasetError
        If the model was trained without labels.
    """
    labeller = model.labeller()
    if labeller is None:
        raise DatasetError("the model was trained without labels, expected some")
    known: tuple[str, ...] = ()
    rows: list[Array] = []
    for done, item in enumerate(frames, start=1):
        scene = labeller.label(item.read(gray=False)[0])
        known = scene.classes
        rows.append(scene.probabilities)
        on_progress("Testing", done, len(frames))
    classes = sorted({*known, *(frame.label for frame in frames)})
    probabilities = np.zeros((len(rows), len(classes)))
    probabilities[:, [classes.index(name) for name in known]] = rows
    return score(probabilities, [frame.label for frame in frames], classes)


def _search(
    frames: Sequence[LabelledFrame],
    params: PlaceParams,
    n_words: int,
    seed: int,
    on_progress: Progress,
) -> Found:
    described = describe_frames(_read(frames, "Describing", on_progress), params)
    words = min(n_words, max(len(described.values), 1))
    try:
        model = fit_model(described, params, n_words=words, seed=seed, trained_on="a search")
    except ValueError as error:
        raise DatasetError(f"cannot search with {len(frames)} frames: {error}") from error
    bags = np.zeros((len(frames), words))
    of_frames = np.split(described.values, np.cumsum(described.counts)[:-1])
    for row, values in zip(bags, of_frames, strict=True):
        bag = model.tf_idf.bag(model.vocabulary.lookup(values))
        row[bag.words] = np.sqrt(bag.weights)
    y = np.array([frame.label for frame in frames])
    folds = SceneClassifier(seed=seed).folds(y, moments(frames))
    on_progress("Searching", 0, 1)
    best, _ = search_svm(bags, y, folds, seed=seed)
    on_progress("Searching", 1, 1)
    return best


def _read(
    frames: Sequence[LabelledFrame], what: str, on_progress: Progress
) -> Iterator[TrainingFrame]:
    names = sequence_names(frames)
    for done, (item, group) in enumerate(zip(frames, names, strict=True), start=1):
        yield TrainingFrame(item.read(gray=False)[0], item.label, group)
        on_progress(what, done, len(frames))
