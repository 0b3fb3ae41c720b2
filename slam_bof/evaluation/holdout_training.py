"""Train a model on labelled frames, and evaluate one trained likewise on frames held out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slam_bof.bof import PlaceParams
from slam_bof.datasets import LabelledFrame, sequence_names
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost
from slam_bof.evaluation.scene_benchmark import SceneResult
from slam_bof.evaluation.scene_metrics import SceneScores, scene_scores
from slam_bof.evaluation.scene_splits import Split, split_by_group, split_by_time
from slam_bof.ports import Dataset
from slam_bof.scenes import (
    ClassifierName,
    FrameDescriptors,
    FurnitureNetwork,
    Model,
    SceneClassifier,
    SvmParams,
    TrainingFrame,
    continue_model,
    cut_segments,
    describe_frames,
    fit_model,
    make_folds,
    model as models,
    search_svm,
    train_model,
)

__all__ = ["TrainedSceneModel", "evaluate_model", "train_scene_model", "train_words"]

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class TrainedSceneModel:
    """A model, and the result of one trained the same way on frames held out.

    ``result`` is None without a check, ``svm_params`` without a grid search.
    """

    model: Model
    result: SceneResult | None = None
    svm_params: SvmParams | None = None

    @property
    def scores(self) -> SceneScores | None:
        """The scores on the frames held out; None without a check."""
        return None if self.result is None else self.result.scores

    @property
    def n_checked(self) -> int:
        """The number of frames held out."""
        return 0 if self.result is None else len(self.result.true)


def _has_shape_words(model: Model | None) -> bool:
    """Return whether a model labels by shape words too, as those of earlier versions may."""
    classifier = None if model is None else model.levelled_classifier
    return classifier is not None and classifier.vocabulary is not None


def _furniture(start: Model | None) -> FurnitureNetwork | None:
    """Return the network of a model's levelled classifier, or that of the included models."""
    if start is None:
        return models.included_furniture()
    classifier = start.levelled_classifier
    return None if classifier is None else classifier.furniture


def train_scene_model(
    frames: Sequence[LabelledFrame],
    params: PlaceParams | None = None,
    *,
    trained_on: str,
    n_words: int = 1024,
    levelled: bool = True,
    constellation: bool = False,
    classifier: ClassifierName | None = None,
    grid_search: bool = False,
    check: bool = True,
    n_copies: int = 0,
    start: Model | None = None,
    seed: int = 0,
    n_jobs: int | None = 1,
    on_progress: Progress = lambda what, done, total: None,
) -> TrainedSceneModel:
    """Train a model on all frames; each is read and described once.

    Parameters
    ----------
    frames
        Frames of at least two classes.
    params
        Parameters of layers, contours and BOF.
    trained_on
        A description of the frames in words, for the model file.
    n_words
        Number of words of the vocabulary.
    levelled
        Whether to train a levelled classifier. Without it, or with ``classifier`` or
        ``grid_search``, the model labels bags of words, as in the paper.
    constellation
        Whether to train a classifier of constellations too, which needs PyTorch and ``levelled``.
    classifier
        One of ``CLASSIFIERS``, for bags of words; by default a linear support vector machine.
    grid_search
        Whether to choose a support vector machine for bags, linear or Gaussian, and its
        parameters by cross-validation.
    check
        Whether to train first on the beginning of every sequence and test on its end
        (``split_by_time``) or, where frames have groups, to keep groups to test with
        (``split_by_group``).
    n_copies
        Copies of each frame as other sensors would have measured it, to train with as well.
    start
        A model to continue, instead of training a new one; its words and parameters stay.
    seed
        Seed of all random numbers.
    n_jobs
        Number of frames described at a time, each in a process of its own; None for that of the
        cluster of ``core.on_cluster``. The model does not depend on it.
    on_progress
        Called with the name of the current task, the number of steps done, and their total.

    Raises
    ------
    DatasetError
        If there are fewer than two classes, too few frames to test with, or fewer descriptors
        than the vocabulary has words.
    """
    params = start.places if start is not None else params or PlaceParams()
    split = Split(list(frames), list(frames))
    if check:
        has_groups = any(frame.group is not None for frame in frames)
        split = split_by_group(frames, seed=seed) if has_groups else split_by_time(frames)
    split.check(min_classes=2 if start is None else 1)
    levelled = levelled and classifier is None and not grid_search
    described = describe_frames(
        _read(frames, on_progress),
        params,
        levelled=levelled,
        with_tokens=constellation,
        with_shapes=_has_shape_words(start),
        furniture=_furniture(start) if levelled else None,
        n_copies=n_copies,
        seed=seed,
        n_jobs=n_jobs,
    )
    index = {id(frame): k for k, frame in enumerate(frames)}
    train, test = ([index[id(frame)] for frame in side] for side in (split.train, split.test))
    bag_classifier = None
    if classifier is not None:
        bag_classifier = SceneClassifier(classifier=classifier, seed=seed)
    svm_params = None
    n_tasks, n_done = check + grid_search + 1, 0

    def fit(selected: FrameDescriptors) -> Model:
        if start is not None:
            return continue_model(start, selected, trained_on=trained_on)
        try:
            return fit_model(
                selected,
                params,
                n_words=n_words,
                seed=seed,
                trained_on=trained_on,
                bag_classifier=bag_classifier,
                constellation=constellation,
            )
        except ValueError as error:
            raise DatasetError(f"cannot train on {len(selected.labels)} frames: {error}") from error

    on_progress("Training", n_done, n_tasks)
    if grid_search:
        svm_params = _search_svm(described.select(train), params, n_words, seed)
        bag_classifier = SceneClassifier(
            classifier=svm_params.name, C=svm_params.C, gamma=svm_params.gamma, seed=seed
        )
        n_done += 1
        on_progress("Training", n_done, n_tasks)
    result = None
    if check:
        cost = Cost()
        with cost.measure():
            checked = fit(described.select(train))
        result = replace(evaluate_model(checked, described.select(test)), train_s=cost.cpu_s)
        n_done += 1
        on_progress("Training", n_done, n_tasks)
    model = fit(described)
    on_progress("Training", n_tasks, n_tasks)
    return TrainedSceneModel(model, result, svm_params)


def train_words(
    datasets: Sequence[Dataset],
    params: PlaceParams,
    *,
    n_words: int = 1024,
    every: int = 1,
    seed: int = 0,
    n_jobs: int | None = 1,
    on_progress: Progress = lambda what, done, total: None,
) -> Model:
    """Train a model without labels: the words and idf of every n-th frame.

    ``n_jobs`` is that of ``train_scene_model``.

    Raises
    ------
    DatasetError
        If there are fewer descriptors than words.
    """
    frames = [(dataset, k) for dataset in datasets for k in range(0, len(dataset), every)]

    def read() -> Iterator[TrainingFrame]:
        for done, (dataset, index) in enumerate(frames, start=1):
            yield TrainingFrame(dataset.frame(index))
            on_progress("Describing", done, len(frames))

    names = ", ".join(sorted({dataset.sequence for dataset in datasets}))
    try:
        return train_model(
            read(),
            params,
            n_words=n_words,
            seed=seed,
            trained_on=names,
            levelled=False,
            n_jobs=n_jobs,
        )
    except ValueError as error:
        raise DatasetError(f"{names}: cannot train on {len(frames)} frames: {error}") from error


def evaluate_model(model: Model, described: FrameDescriptors) -> SceneResult:
    """Test a model on labelled frames; frames of classes it does not know count as wrong.

    Raises
    ------
    DatasetError
        If the model was trained without labels.
    """
    if model.levelled_classifier is not None:
        scenes = [model.levelled_classifier.label_features(f) for f in described.levelled]
    elif model.bag_classifier is None:
        raise DatasetError("the model was trained without labels, expected some")
    else:
        scenes = [
            model.bag_classifier.predict_bag(model.tf_idf.bag(model.vocabulary.lookup(values)))
            for values in described.by_frame()
        ]
    true = [label or "" for label in described.labels]
    known = scenes[0].classes
    classes = sorted({*known, *true})
    probabilities = np.zeros((len(scenes), len(classes)))
    columns = [classes.index(name) for name in known]
    probabilities[:, columns] = [scene.probabilities for scene in scenes]
    return SceneResult(
        method="levelled" if model.levelled_classifier is not None else "bag",
        scores=scene_scores(probabilities, true, classes),
        probabilities=probabilities,
        true=tuple(true),
    )


def _search_svm(
    described: FrameDescriptors, params: PlaceParams, n_words: int, seed: int
) -> SvmParams:
    words = min(n_words, max(len(described.values), 1))
    try:
        model = fit_model(described, params, n_words=words, seed=seed, trained_on="a search")
    except ValueError as error:
        raise DatasetError(f"cannot search with {len(described.labels)} frames: {error}") from error
    bags = np.zeros((len(described.labels), words))
    for row, values in zip(bags, described.by_frame(), strict=True):
        bag = model.tf_idf.bag(model.vocabulary.lookup(values))
        row[bag.words] = np.sqrt(bag.weights)
    y = np.array(described.labels)
    groups = cut_segments(y.tolist(), described.groups)
    folds = make_folds(y, groups, SceneClassifier().n_folds, seed)
    best, _ = search_svm(bags, y, folds, seed=seed)
    return best


def _read(frames: Sequence[LabelledFrame], on_progress: Progress) -> Iterator[TrainingFrame]:
    names = sequence_names(frames)
    for done, (item, group) in enumerate(zip(frames, names, strict=True), start=1):
        yield TrainingFrame(
            item.read(gray=False)[0],
            item.label,
            group,
            None if item.gravity_camera is None else np.array(item.gravity_camera),
            is_room=item.group is not None,
        )
        on_progress("Describing", done, len(frames))
