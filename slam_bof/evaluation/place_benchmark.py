"""Compare descriptors by how often they find a place again, by the protocol of ``recognition``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import InvertedIndex, TfIdf, Vocabulary
from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost, one_thread
from slam_bof.evaluation.descriptor_runs import Described, learn_bags
from slam_bof.evaluation.place_protocol import ProtocolParams, eligible, truths
from slam_bof.evaluation.retrieval_metrics import judge
from slam_bof.places import PlaceRecogniser, RecogniserParams
from slam_bof.ports import Dataset, Descriptor, Odometry
from slam_bof.scenes import model as models
from slam_bof.types import Bag, Pose

__all__ = ["RECOGNISER", "Scored", "evaluate_places", "score_rows"]

RECOGNISER = "recogniser"
"""What ``slam_bof.recogniser`` goes by among the descriptors."""

Progress = Callable[[str, int, int], None]
Truths = dict[str, NDArray[np.bool_]]
Bags = tuple[Vocabulary, TfIdf]


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """How alike a method finds each two frames, ``scores`` (K, K), and what that costs.

    ``query_ms`` is the CPU that a frame's comparison with all others takes.
    """

    method: str
    scores: NDArray[np.float32]
    describe: Cost
    query_ms: float
    n_bytes: int


OnScored = Callable[[Dataset, Sequence[int], Scored, Truths, NDArray[np.bool_]], None]


def evaluate_places(
    datasets: Sequence[Dataset],
    names: Sequence[str],
    *,
    training: Sequence[Dataset] = (),
    params: ProtocolParams | None = None,
    n_words: int = 1024,
    recogniser: RecogniserParams | None = None,
    odometry: str = "kiss-icp",
    seed: int = 0,
    on_progress: Progress = lambda what, done, total: None,
    on_scored: OnScored = lambda dataset, indices, scored, right, allowed: None,
) -> list[dict[str, Any]]:
    """Judge descriptor plug-ins, and the recogniser, on sequences with ground truth.

    Parameters
    ----------
    datasets
        Each is judged by itself.
    names
        The plug-ins, and ``RECOGNISER``, which is judged before and after it aligns.
    training
        Sequences whose frames vocabularies are learnt of. Without any, ``bof`` has the model that
        comes along, and other local features are left out.
    recogniser, odometry
        Parameters of the recogniser, and the plug-in that it is beside.
    on_scored
        Called with each sequence, its frames that ask and answer, what a method says of them, and
        what is right and what may answer, (K, K) each.

    Returns
    -------
    list of dict
        One for each sequence and method: ``sequence``, ``descriptor``, ``describe_ms`` and
        ``query_ms`` (CPU, medians), ``bytes_per_frame``, and for each truth, ``pose`` and
        ``overlap``, the figures of ``Recognition``, or None where nothing comes back; or else
        ``left_out``, saying why.

    Raises
    ------
    DatasetError
        If a sequence has no ground truth, or lacks some of its poses.
    """
    params = params or ProtocolParams()
    rows: list[dict[str, Any]] = []
    vocabularies: dict[str, Bags] = {}
    with one_thread():
        for dataset in datasets:
            indices = list(range(0, len(dataset), params.every))
            right = _truths(dataset, indices, params)
            allowed = eligible(indices, params)
            for name in names:
                if name == RECOGNISER:
                    built: Odometry = registry.build("odometry", odometry)
                    found = _recognise(
                        recogniser, built, dataset, indices, allowed, seed, on_progress
                    )
                else:
                    descriptor: Descriptor = registry.build("descriptors", name)
                    missing = _missing(name, descriptor, dataset, training)
                    if missing:
                        where = {"sequence": dataset.sequence, "descriptor": name}
                        rows.append({**where, "left_out": missing})
                        continue
                    if descriptor.comparison == "bag" and name not in vocabularies:
                        vocabularies[name] = _learn(name, descriptor, training, n_words, seed)
                    bags = vocabularies.get(name)
                    found = [_compare(name, descriptor, bags, dataset, indices, on_progress)]
                for scored in found:
                    on_scored(dataset, indices, scored, right, allowed)
                    row: dict[str, Any] = {
                        "sequence": dataset.sequence,
                        "descriptor": scored.method,
                        "describe_ms": scored.describe.median_ms,
                        "query_ms": scored.query_ms,
                        "bytes_per_frame": scored.n_bytes / len(indices),
                    }
                    for kind, truth in right.items():
                        judged = judge(scored.scores, truth, allowed)
                        row[kind] = asdict(judged) if judged else None
                    rows.append(row)
    return rows


def score_rows(values: NDArray[Any], comparison: str) -> NDArray[np.float32]:
    """Return how alike rows (K, D) are, each to each, (K, K); the most alike are highest."""
    if comparison == "cosine":
        values = values.astype(np.float32)
        lengths = np.linalg.norm(values, axis=1, keepdims=True)
        unit = values / np.where(lengths > 0, lengths, 1.0)
        return np.asarray(unit @ unit.T)
    if comparison == "l1":
        values = values.astype(np.float32)
        return np.stack([-np.abs(values - row).mean(axis=1) for row in values])
    if comparison == "equal":
        return np.stack([(values == row).mean(axis=1, dtype=np.float32) for row in values])
    raise ValueError(f"comparison must be cosine, l1 or equal, got {comparison!r}")


def _score_bags(bags: Sequence[Bag], n_words: int) -> NDArray[np.float32]:
    index = InvertedIndex(n_words)
    for bag in bags:
        index.add(bag)
    return np.stack([index.scores(bag) for bag in bags])


def _truths(dataset: Dataset, indices: list[int], params: ProtocolParams) -> Truths:
    groundtruth = dataset.groundtruth()
    if groundtruth is None:
        raise DatasetError(f"{dataset.sequence}: found no ground truth, expected poses to judge by")
    if not np.isfinite(groundtruth.poses[indices]).all():
        raise DatasetError(f"{dataset.sequence}: found frames without pose, expected all to have")
    frames = [dataset.frame(index) for index in indices]
    return truths(frames, indices, groundtruth, params)


def _missing(
    name: str, descriptor: Descriptor, dataset: Dataset, training: Sequence[Dataset]
) -> str | None:
    """Say why a descriptor cannot be judged here, if so."""
    if descriptor.comparison == "bag" and name != "bof" and not training:
        return "needs sequences to learn words of"
    if descriptor.needs_gray:
        dark = [other.sequence for other in (dataset, *training) if other.gray(0) is None]
        if dark:
            return f"no colour images in {', '.join(dark)}"
    return None


def _compare(
    name: str,
    descriptor: Descriptor,
    bags: Bags | None,
    dataset: Dataset,
    indices: Sequence[int],
    on_progress: Progress,
) -> Scored:
    describe, query, found = Cost(), Cost(), Described(descriptor)
    for done, index in enumerate(indices, start=1):
        frame = dataset.frame(index)
        gray = dataset.gray(index) if descriptor.needs_gray else None
        with describe.measure():
            values = descriptor.describe(frame, gray)
        found.keep(values)
        on_progress(f"{dataset.sequence} {name}", done, len(indices))
    if bags is None:
        stacked, n_bytes = np.concatenate(found.values), found.nbytes
        with query.measure():
            scores = score_rows(stacked, descriptor.comparison)
    else:
        words = [_bag(found.numbers(values), *bags) for values in found.values]
        n_bytes = sum(bag.words.nbytes + bag.weights.nbytes for bag in words)
        with query.measure():
            scores = _score_bags(words, len(bags[1].idf_))
    return Scored(name, scores, describe, 1e3 * query.cpu_s / len(indices), n_bytes)


def _recognise(
    params: RecogniserParams | None,
    odometry: Odometry,
    dataset: Dataset,
    indices: Sequence[int],
    allowed: NDArray[np.bool_],
    seed: int,
    on_progress: Progress,
) -> list[Scored]:
    """Judge the recogniser twice: by what looks alike, and by what it says after aligning."""
    recogniser = PlaceRecogniser(params, seed=seed)
    describe, retrieve, align = Cost(), Cost(), Cost()
    alike = np.full(allowed.shape, -np.inf, np.float32)
    aligned = alike.copy()
    asking = set(indices)
    for index in range(indices[-1] + 1):
        frame = dataset.frame(index)
        T_odom_camera: Pose = odometry.process(frame)
        if index not in asking:
            continue
        with describe.measure():
            query = recogniser.add(frame, T_odom_camera)
        n_views = int(allowed[query].sum())
        with retrieve.measure():
            shortlist = recogniser.retrieve(query, n_views)
        with align.measure():
            matches = recogniser.rank(query, shortlist)
        alike[query, :n_views] = shortlist.scores
        # What was aligned comes before all that was not.
        aligned[query, :n_views] = shortlist.scores - 10.0
        for match in matches:
            aligned[query, match.view_id] = match.score
        on_progress(f"{dataset.sequence} {RECOGNISER}", query + 1, len(indices))
    n_bytes = recogniser.nbytes
    both_ms = retrieve.median_ms + align.median_ms
    return [
        Scored(f"{RECOGNISER}, unaligned", alike, describe, retrieve.median_ms, n_bytes),
        Scored(RECOGNISER, aligned, describe, both_ms, n_bytes),
    ]


def _learn(
    name: str,
    descriptor: Descriptor,
    training: Sequence[Dataset],
    n_words: int,
    seed: int,
) -> Bags:
    """Learn words and idf of the training sequences, or take the shipped ones."""
    if not training:
        model = models.load_default()
        return model.vocabulary, model.tf_idf
    found = Described(descriptor)
    for dataset in training:
        for index in range(len(dataset)):
            gray = dataset.gray(index) if descriptor.needs_gray else None
            found.keep(descriptor.describe(dataset.frame(index), gray))
    try:
        bags, _ = learn_bags(found, name, n_words=n_words, seed=seed)
    except DatasetError as error:
        sequences = ", ".join(dataset.sequence for dataset in training)
        raise DatasetError(f"{sequences}: {error}") from None
    return bags


def _bag(values: NDArray[np.float32], vocabulary: Vocabulary, tf_idf: TfIdf) -> Bag:
    return tf_idf.bag(vocabulary.lookup(values))
