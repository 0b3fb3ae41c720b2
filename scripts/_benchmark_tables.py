"""Markdown tables of what ``slam-bof run``, ``bench`` and ``evaluate`` print with ``--json``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from _measure import cell

__all__ = ["cost_table", "places_table", "run_table", "scenes_table"]

RUN_COLUMNS = {
    "sequence": "sequence", "n_frames": "frames", "n_keyframes": "keyframes",
    "ate_odometry_m": "ATE of odometry, m", "ate_live_m": "ATE live, m", "ate_m": "ATE after, m",
    "ate_max_m": "largest, m", "keyframe_nees": "NEES, keyframes", "edge_nees": "NEES, edges",
    "rpe_odometry_m": "RPE of odometry, m", "rpe_m": "RPE after, m", "n_loops": "loops",
    "loop_precision": "precision", "loop_recall": "recall", "scene_accuracy": "labels, raw",
    "scene_accuracy_smoothed": "labels, smoothed", "fps": "frames/s",
    "stage_ms.odometry": "odometry, ms", "stage_ms.total": "total, ms", "peak_rss_mb": "MB",
}  # fmt: skip
PLACES_COLUMNS = ("R@1", "R@5", "R@10", "R@20", "AP", "recall at P = 1", "queries")
SCENES_COLUMNS = {
    "accuracy": "accuracy", "mean_class_accuracy": "mean of classes",
    "calibration_error": "ECE", "label_ms": "CPU ms a frame", "train_s": "training, CPU s",
}  # fmt: skip


def run_table(outputs: Sequence[str]) -> list[str]:
    """Return a row for each run."""
    rows = [json.loads(text) for text in outputs]
    return _table(RUN_COLUMNS.values(), ([row.get(key) for key in RUN_COLUMNS] for row in rows))


def cost_table(outputs: Sequence[str]) -> list[str]:
    """Return the paper's Table 7, CPU seconds of each process by method, and index queries."""
    lines: list[str] = []
    for text in outputs:
        figures = json.loads(text)
        methods = figures["methods"]
        rows = [
            [f"process {k}, CPU s", *(m["process_cpu_s"][str(k)] for m in methods.values())]
            for k in range(1, 10)
        ]
        for key in ("describe_ms", "bag_ms", "descriptor_bytes", "bag_bytes", "codebook_bytes"):
            rows.append([key.replace("_", " "), *(m[key] for m in methods.values())])
        lines += _table(["", *methods], rows)
        sizes = [[n, *index.values()] for n, index in figures["index"].items()]
        headings = ["keyframes in the index", "query, ms", "adding, ms", "bytes a keyframe"]
        lines += ["", *_table(headings, sizes)]
    return lines


def places_table(outputs: Sequence[str]) -> list[str]:
    """Return a row for each method and sequence, for each of the two truths."""
    lines: list[str] = []
    rows = [row for text in outputs for row in json.loads(text)]
    for truth in ("pose", "overlap"):
        table = []
        for row in rows:
            if "left_out" in row:
                continue
            metrics = row[truth]
            figures: list[Any] = [None] * len(PLACES_COLUMNS)
            if metrics:
                figures = list(metrics["recall_at"].values())
                figures += [metrics["average_precision"], metrics["recall_at_full_precision"]]
                figures.append(metrics["n_queries"])
            cost = [row["describe_ms"], row["query_ms"], round(row["bytes_per_frame"])]
            table.append([row["sequence"], row["descriptor"], *figures, *cost])
        headings = ["sequence", "method", *(f"{name}, {truth}" for name in PLACES_COLUMNS)]
        lines += [*_table([*headings, "CPU ms", "query ms", "bytes"], table), ""]
    left_out = [row for row in rows if "left_out" in row]
    return lines + [f"{r['descriptor']}, {r['sequence']}: {r['left_out']}." for r in left_out]


def scenes_table(outputs: Sequence[str]) -> list[str]:
    """Return a row for each method of each protocol."""
    rows = []
    for text in outputs:
        figures = json.loads(text)
        for name, method in figures["methods"].items():
            rows.append([figures["protocol"], name, *(method[key] for key in SCENES_COLUMNS)])
    return _table(["protocol", "method", *SCENES_COLUMNS.values()], rows)


def _table(headings: Iterable[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    headings = list(headings)
    lines = [headings, ["---"] * len(headings), *([cell(value) for value in row] for row in rows)]
    return [f"| {' | '.join(line)} |" for line in lines]
