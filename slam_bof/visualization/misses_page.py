"""A page with the queries that place recognition answered wrongly, as depth images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.ports import Dataset
from slam_bof.visualization.depth_pictures import MAX_DEPTH_M, depth_picture
from slam_bof.visualization.html_page import render_page, section

__all__ = ["MissedQueries", "MissedQuery", "find_missed_queries", "write_missed_queries"]

MAX_SHOWN = 24
"""Largest number of missed queries that are drawn for a method, evenly spaced."""


@dataclass(frozen=True, slots=True)
class MissedQuery:
    """A query (row of the scores) whose best answer is wrong.

    ``right`` is the best of the right answers, at ``rank``, counted from 1.
    """

    query: int
    answer: int
    right: int
    rank: int


@dataclass(frozen=True, slots=True, eq=False)
class MissedQueries:
    """The missed queries of a method on a sequence.

    ``frames`` (K,) are the indices of the frames that are rows and columns of the scores.
    """

    method: str
    dataset: Dataset
    frames: Sequence[int]
    n_queries: int
    misses: Sequence[MissedQuery]


def find_missed_queries(
    scores: NDArray[np.floating], truth: NDArray[np.bool_], allowed: NDArray[np.bool_]
) -> tuple[int, list[MissedQuery]]:
    """Return how many queries have a right answer, and which of them were answered wrongly.

    Parameters
    ----------
    scores, truth, allowed
        (K, K) for query (row) and answer (column): the score, whether the answer is right, and
        whether it may be given at all.

    >>> scores = np.array([[0, 0, 0], [0.9, 0, 0], [0.5, 0.8, 0]])
    >>> truth = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bool)
    >>> find_missed_queries(scores, truth, np.tri(3, k=-1, dtype=bool))
    (2, [MissedQuery(query=2, answer=1, right=0, rank=2)])
    """
    truth = truth & allowed
    queries = np.flatnonzero(truth.any(axis=1))
    order = np.argsort(-np.where(allowed, scores, -np.inf), axis=1, kind="stable")
    misses = []
    for query in queries.tolist():
        place = int(truth[query, order[query]].argmax())
        if place > 0:
            answer, right = int(order[query, 0]), int(order[query, place])
            misses.append(MissedQuery(query, answer, right, place + 1))
    return len(queries), misses


def write_missed_queries(path: Path, missed: Sequence[MissedQueries]) -> None:
    """Write a page with query, wrong answer and right answer of each missed query."""
    body = "".join(_sections(one) for one in missed)
    sequences = ", ".join(dict.fromkeys(one.dataset.sequence for one in missed))
    page = render_page(title="Places not recognised", subtitle=sequences, body=body, script="")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def _sections(missed: MissedQueries) -> str:
    shown = np.linspace(0, len(missed.misses) - 1, min(MAX_SHOWN, len(missed.misses))).round()
    text = f"{len(missed.misses)} of {missed.n_queries} queries got a wrong answer"
    text += f"; {len(shown)} of these are shown." if len(shown) < len(missed.misses) else "."
    text += f" Depth from 0 (dark) to {MAX_DEPTH_M:g} m (bright); black where it is missing."
    found = [section(f"{missed.method} on {missed.dataset.sequence}", text)]
    for k in shown.astype(int).tolist():
        miss = missed.misses[k]
        query, answer, right = (missed.frames[i] for i in (miss.query, miss.answer, miss.right))
        figures = (
            _figure(missed.dataset, query, f"query: frame {query}"),
            _figure(missed.dataset, answer, f"answered: frame {answer}"),
            _figure(missed.dataset, right, f"right, at rank {miss.rank}: frame {right}"),
        )
        found.append(section(f"Frame {query}", "", *figures))
    return "".join(found)


def _figure(dataset: Dataset, index: int, caption: str) -> str:
    return depth_picture(dataset.frame(index).depth_m(), caption)
