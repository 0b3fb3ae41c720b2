"""Runs over several sequences, several at a time."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import joblib

from slam_bof.errors import SlamBofError
from slam_bof.ports import Dataset
from slam_bof.run.job import RunResult
from slam_bof.run.options import RunOptions
from slam_bof.run.run import WHOLE, run_sequence
from slam_bof.slam import Config

__all__ = ["SequenceRun", "run_sequences"]

logger = logging.getLogger(__name__)

Open = Callable[[Path], tuple[Dataset, list[str]]]
"""Opens a sequence; returns it, and first lines of its ``run.log``."""


@dataclass(frozen=True, slots=True)
class SequenceRun:
    """What came of one sequence: a result, or else the error that ended its run."""

    sequence: Path
    result: RunResult | None
    error: str = ""


def run_sequences(
    sequences: Sequence[Path],
    open_: Open,
    config: Config,
    out: Path,
    options: RunOptions = WHOLE,
    *,
    n_jobs: int | None = 1,
    frames: str | None = None,
) -> Iterator[SequenceRun]:
    """Run the mini-SLAM over sequences, each with a folder of its own under ``out``.

    A sequence that fails does not stop the others. The files of a run do not depend on ``n_jobs``.
    With ``core.on_cluster`` around the loop, the runs go to a Dask cluster.

    Parameters
    ----------
    sequences, open_
        The sequences, and the function that opens one.
    config, out
        All parameters of all runs, and the folder for theirs.
    options
        How far each run goes, and how it writes ``map.ply``.
    n_jobs
        Number of runs at a time, each in a process of its own; None for that of the cluster.
    frames
        The frames of each sequence that ``open_`` selects, to be kept in the map for resuming.

    Yields
    ------
    SequenceRun
        In the order of the sequences.
    """
    jobs = [
        joblib.delayed(_run)(sequence, open_, config, folder, options, frames)
        for sequence, folder in zip(sequences, _folders(sequences, out), strict=True)
    ]
    yield from joblib.Parallel(n_jobs=n_jobs, return_as="generator")(jobs)


def _run(
    sequence: Path,
    open_: Open,
    config: Config,
    out: Path,
    options: RunOptions,
    frames: str | None,
) -> SequenceRun:
    source = json.dumps({"path": str(sequence.resolve()), "frames": frames})
    try:
        dataset, remarks = open_(sequence)
        result = run_sequence(dataset, config, out, options, source=source, remarks=remarks)
    except SlamBofError as error:
        return SequenceRun(sequence, None, str(error))
    except Exception as error:
        logger.exception("%s", sequence)
        return SequenceRun(sequence, None, f"{sequence}: {type(error).__name__}: {error}")
    return SequenceRun(sequence, result)


def _folders(sequences: Sequence[Path], out: Path) -> list[Path]:
    """Return a folder for each sequence, named by the last two parts of its path.

    >>> paths = [Path("a/office/seq-01"), Path("a/office/seq-02"), Path("b/office/seq-01")]
    >>> [folder.as_posix() for folder in _folders(paths, Path("runs"))]
    ['runs/office-seq-01', 'runs/office-seq-02', 'runs/office-seq-01-2']
    """
    seen: Counter[str] = Counter()
    folders = []
    for sequence in sequences:
        name = "-".join(sequence.resolve().parts[-2:]).replace("/", "")
        seen[name] += 1
        folders.append(out / (name if seen[name] == 1 else f"{name}-{seen[name]}"))
    return folders
