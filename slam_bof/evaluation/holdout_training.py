"""Train a model on labelled frames, and check it on frames held out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slam_bof.bof import PlaceParams
from slam_bof.datasets import LabelledFrame, sequence_names
from slam_bof.errors import DatasetError
from slam_bof.evaluation.scene_metrics import SceneScores, score
from slam_bof.evaluation.scene_splits import Split, split_by_time
from slam_bof.scenes import (
    Descriptors,
    Found,
    MachineName,
    Model,
    SceneClassifier,
    TrainingFrame,
    cut_stretches,
    describe_frames,
    fit_model,
    search_svm,
)

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
    """Train a model on all frames; each is read and described once.

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
        Label levelled views, the product's way; without, or with a classifier of bags or a
        search for one, bags of words, the paper's.
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
    levelled = levelled and classifier is None and not grid_search
    described = describe_frames(_read(frames, on_progress), params, levelled=levelled)
    numbers = {id(frame): k for k, frame in enumerate(frames)}
    train, test = ([numbers[id(frame)] for frame in side] for side in (split.train, split.test))
    scenes = None if classifier is None else SceneClassifier(machine=classifier, seed=seed)
    found = None
    n_tasks, n_done = check + grid_search + 1, 0

    def fit(part: Descriptors) -> Model:
        try:
            return fit_model(
                part, params, n_words=n_words, seed=seed, trained_on=trained_on, scenes=scenes
            )
        except ValueError as error:
            raise DatasetError(f"cannot train on {len(part.labels)} frames: {error}") from error

    on_progress("Training", n_done, n_tasks)
    if grid_search:
        found = _search(described.select(train), params, n_words, seed)
        scenes = SceneClassifier(machine=found.name, C=found.C, gamma=found.gamma, seed=seed)
        n_done += 1
        on_progress("Training", n_done, n_tasks)
    scores = None
    if check:
        scores = judge_model(fit(described.select(train)), described.select(test))
        n_done += 1
        on_progress("Training", n_done, n_tasks)
    model = fit(described)
    on_progress("Training", n_tasks, n_tasks)
    return TrainedScenes(model, scores, found, len(test) if check else 0)


def judge_model(model: Model, described: Descriptors) -> SceneScores:
    """Judge a model by frames with labels; those of classes it does not know count as wrong.

    Raises
    ------
    DatasetError
        If the model was trained without labels.
    """
    if model.scenes is None:
        raise DatasetError("the model was trained without labels, expected some")
    if model.levels is not None:
        found = [model.levels.label_view(view) for view in described.views]
    else:
        found = [
            model.scenes.predict_bag(model.tf_idf.bag(model.vocabulary.lookup(values)))
            for values in described.of_frames()
        ]
    true = [label or "" for label in described.labels]
    known = [str(name) for name in model.scenes.classes_]
    classes = sorted({*known, *true})
    probabilities = np.zeros((len(found), len(classes)))
    columns = [classes.index(name) for name in known]
    probabilities[:, columns] = [scene.probabilities for scene in found]
    return score(probabilities, true, classes)


def _search(described: Descriptors, params: PlaceParams, n_words: int, seed: int) -> Found:
    words = min(n_words, max(len(described.values), 1))
    try:
        model = fit_model(described, params, n_words=words, seed=seed, trained_on="a search")
    except ValueError as error:
        raise DatasetError(f"cannot search with {len(described.labels)} frames: {error}") from error
    bags = np.zeros((len(described.labels), words))
    for row, values in zip(bags, described.of_frames(), strict=True):
        bag = model.tf_idf.bag(model.vocabulary.lookup(values))
        row[bag.words] = np.sqrt(bag.weights)
    y = np.array(described.labels)
    groups = cut_stretches(y.tolist(), described.groups)
    best, _ = search_svm(bags, y, SceneClassifier(seed=seed).folds(y, groups), seed=seed)
    return best


def _read(frames: Sequence[LabelledFrame], on_progress: Progress) -> Iterator[TrainingFrame]:
    names = sequence_names(frames)
    for done, (item, group) in enumerate(zip(frames, names, strict=True), start=1):
        yield TrainingFrame(item.read(gray=False)[0], item.label, group)
        on_progress("Describing", done, len(frames))
