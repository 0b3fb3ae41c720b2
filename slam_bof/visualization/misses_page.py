"""Pictures of what place recognition got wrong, side by side."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.ports import Dataset
from slam_bof.visualization.html_page import fill, section

__all__ = ["Miss", "Missed", "find_misses", "write_misses"]

MAX_SHOWN = 24
"""Misses of a method that are drawn, spread over all."""
WIDTH_PX = 320
FAR_M = 5.0
"""Depth is coloured from 0 to here."""


@dataclass(frozen=True, slots=True)
class Miss:
    """A query (row of the scores) whose best answer is wrong.

    ``right`` is the right answer that came first, at ``rank``, counted from 1.
    """

    query: int
    answer: int
    right: int
    rank: int


@dataclass(frozen=True, slots=True, eq=False)
class Missed:
    """What a method missed on a sequence; ``frames`` (K,) are those that asked and answered."""

    method: str
    dataset: Dataset
    frames: Sequence[int]
    n_queries: int
    misses: Sequence[Miss]


def find_misses(
    scores: NDArray[np.floating], truth: NDArray[np.bool_], allowed: NDArray[np.bool_]
) -> tuple[int, list[Miss]]:
    """Return how many queries have a right answer, and those that got a wrong one.

    ``scores``, ``truth`` and ``allowed`` (K, K) are as ``recognition.judge`` has them.

    >>> scores = np.array([[0, 0, 0], [0.9, 0, 0], [0.5, 0.8, 0]])
    >>> truth = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bool)
    >>> find_misses(scores, truth, np.tri(3, k=-1, dtype=bool))
    (2, [Miss(query=2, answer=1, right=0, rank=2)])
    """
    truth = truth & allowed
    asked = np.flatnonzero(truth.any(axis=1))
    order = np.argsort(-np.where(allowed, scores, -np.inf), axis=1, kind="stable")
    misses = []
    for query in asked.tolist():
        place = int(truth[query, order[query]].argmax())
        if place > 0:
            answer, right = int(order[query, 0]), int(order[query, place])
            misses.append(Miss(query, answer, right, place + 1))
    return len(asked), misses


def write_misses(path: Path, missed: Sequence[Missed]) -> None:
    """Write a page with, for each miss, the query, what was answered, and what was right."""
    body = "".join(_sections(of) for of in missed)
    sequences = ", ".join(dict.fromkeys(of.dataset.sequence for of in missed))
    page = fill(title="Places not recognised", subtitle=sequences, body=body, script="")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding="utf-8")


def _sections(of: Missed) -> str:
    shown = np.linspace(0, len(of.misses) - 1, min(MAX_SHOWN, len(of.misses))).round()
    text = f"{len(of.misses)} of {of.n_queries} queries got a wrong answer"
    text += f"; {len(shown)} of these are shown." if len(shown) < len(of.misses) else "."
    text += f" Depth from 0 (dark) to {FAR_M:g} m (bright); black where it is missing."
    found = [section(f"{of.method} on {of.dataset.sequence}", text)]
    for k in shown.astype(int).tolist():
        miss = of.misses[k]
        query, answer, right = (of.frames[i] for i in (miss.query, miss.answer, miss.right))
        figures = (
            _figure(of.dataset, query, f"query: frame {query}"),
            _figure(of.dataset, answer, f"answered: frame {answer}"),
            _figure(of.dataset, right, f"right, at rank {miss.rank}: frame {right}"),
        )
        found.append(section(f"Frame {query}", "", *figures))
    return "".join(found)


def _figure(dataset: Dataset, index: int, caption: str) -> str:
    depth_m = dataset.frame(index).depth_m()
    height = round(WIDTH_PX * depth_m.shape[0] / depth_m.shape[1])
    small = cv2.resize(depth_m, (WIDTH_PX, height), interpolation=cv2.INTER_NEAREST)
    levels = np.clip(255.0 * small / FAR_M, 0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)
    picture[small == 0] = 0
    _, coded = cv2.imencode(".jpg", picture)
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    return (
        f'<figure><img alt="{caption}" src="data:image/jpeg;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
