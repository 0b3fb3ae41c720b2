"""Scene labels of rooms never seen: labelled images, cross-validated by group (room).

Images of one room are alike, so a room is either trained with or tested with. Every method gets
the same folds; each image is described once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold

from slam_bof.datasets import LabelledFrame, sequence_names
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import one_thread
from slam_bof.evaluation.group_methods import GROUP_METHODS, GroupMethod, make_group_method
from slam_bof.evaluation.scene_benchmark import SceneResult, each_by_itself
from slam_bof.evaluation.scene_metrics import scene_scores
from slam_bof.scenes import remeasure
from slam_bof.types import Array

__all__ = ["check_groups", "cross_validate_groups"]

Progress = Callable[[str, int, int], None]


def check_groups(frames: Sequence[LabelledFrame], n_folds: int) -> None:
    """Raise ``DatasetError`` unless there are two classes and a group for every fold."""
    classes, groups = {frame.label for frame in frames}, set(sequence_names(frames))
    if len(classes) < 2 or len(groups) < n_folds:
        raise DatasetError(
            f"found {len(classes)} classes in {len(groups)} groups, expected at least two classes "
            f"and as many groups as folds, {n_folds}"
        )


def cross_validate_groups(
    frames: Sequence[LabelledFrame],
    methods: Sequence[str] = GROUP_METHODS,
    *,
    n_folds: int = 5,
    n_repeats: int = 3,
    n_copies: int = 3,
    share: float = 1.0,
    n_words: int = 1024,
    seed: int = 0,
    n_jobs: int | None = 1,
    on_progress: Progress = lambda what, done, total: None,
) -> list[SceneResult]:
    """Test methods on groups that they were not trained with.

    Parameters
    ----------
    frames
        Labelled frames; those without a group are of the group of their sequence.
    methods
        Names among ``GROUP_METHODS``.
    n_folds, n_repeats
        Folds, and how many times the groups are dealt out to them.
    n_copies
        Copies of each training image as other sensors would have measured it.
    share
        Share of the training groups that is used, for a learning curve.
    n_words
        Words of the bags' vocabulary.
    seed
        Seed of folds, copies and classifiers.
    n_jobs
        Number of methods evaluated at a time; see ``compare_named_methods``.

    Returns
    -------
    list of SceneResult
        In the order of ``methods``; every frame is tested ``n_repeats`` times.

    Raises
    ------
    DatasetError
        If a method is unknown, or there are too few classes or groups.
    """
    check_groups(frames, n_folds)
    made = [make_group_method(name, n_words, seed) for name in methods]
    if n_jobs != 1:
        alone = partial(
            cross_validate_groups,
            frames,
            n_folds=n_folds,
            n_repeats=n_repeats,
            n_copies=n_copies,
            share=share,
            n_words=n_words,
            seed=seed,
        )
        found = each_by_itself(alone, methods, n_jobs, on_progress)
        return [result for of_method in found for result in of_method]
    labels, groups = [frame.label for frame in frames], sequence_names(frames)
    classes = sorted(set(labels))
    y, g = np.array(labels), np.array(groups)
    with one_thread():
        _describe(frames, made, n_copies, seed, on_progress)
        probabilities: dict[str, list[Array]] = {method.name: [] for method in made}
        for repeat in range(n_repeats):
            out = {method.name: np.zeros((len(y), len(classes))) for method in made}
            folds = StratifiedGroupKFold(n_folds, shuffle=True, random_state=seed + repeat)
            for k, (train, test) in enumerate(folds.split(y, y, g)):
                train = _thin(train, y, g, share, seed + repeat)
                for method in made:
                    _test(method, train, test, y, g, classes, out[method.name])
                on_progress("Testing", repeat * n_folds + k + 1, n_repeats * n_folds)
            for name, values in out.items():
                probabilities[name].append(values)
    true = tuple(labels * n_repeats)
    results = []
    for method in made:
        p = np.concatenate(probabilities[method.name])
        results.append(
            SceneResult(
                method=method.name,
                scores=scene_scores(p, true, classes),
                probabilities=p,
                true=true,
                label_ms=method.label_cost.median_ms,
                train_s=method.train_cost.cpu_s / (n_folds * n_repeats),
                n_bytes=method.n_bytes,
            )
        )
    return results


def _thin(
    train: NDArray[np.intp], y: NDArray[Any], g: NDArray[Any], share: float, seed: int
) -> NDArray[np.intp]:
    """Return the training samples of a share of each class's groups, at least one group each."""
    if share >= 1.0:
        return train
    rng = np.random.default_rng(seed)
    kept: list[Any] = []
    for label in np.unique(y[train]):
        of_class = np.unique(g[train][y[train] == label])
        kept += rng.permutation(of_class)[: max(1, round(share * len(of_class)))].tolist()
    return train[np.isin(g[train], kept)]


def _describe(
    frames: Sequence[LabelledFrame],
    methods: Sequence[GroupMethod],
    n_copies: int,
    seed: int,
    on_progress: Progress,
) -> None:
    rng = np.random.default_rng(seed)
    for done, item in enumerate(frames, start=1):
        frame, _ = item.read(gray=False)
        down = None if item.gravity_camera is None else np.array(item.gravity_camera)
        measured = [remeasure(frame, rng, down) for _ in range(n_copies)]
        for method in methods:
            # What a frame keeps of its first description would flatter the next method.
            fresh = replace(frame)
            with method.label_cost.measure():
                method.described.append(method.describe(fresh, down))
            copies = measured if method.uses_copies else []
            method.copies.append([method.describe(*copy) for copy in copies])
        on_progress("Describing", done, len(frames))


def _test(
    method: GroupMethod,
    train: NDArray[np.intp],
    test: NDArray[np.intp],
    y: NDArray[Any],
    g: NDArray[Any],
    classes: Sequence[str],
    out: Array,
) -> None:
    """Train on some images; write the probabilities of others, in the order of ``classes``."""
    with method.train_cost.measure():
        predict, method.n_bytes = method.fit(
            [method.described[k] for k in train],
            [method.copies[k] for k in train],
            y[train].tolist(),
            g[train].tolist(),
        )
    for k in test:
        known, p = predict(method.described[k])
        out[k, [classes.index(name) for name in known]] = p
