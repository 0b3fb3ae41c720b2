"""How methods of scene labelling did: tables, and figures for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from slam_bof.evaluation import SceneResult

__all__ = ["print_results", "result_figures"]


def print_results(
    title: str,
    results: Sequence[SceneResult],
    left_out: dict[str, str],
    files: Sequence[Path],
) -> None:
    """Print a table of methods, and the recall of each class."""
    from slam_bof.cli.console import print_table

    rows = [
        (
            r.method,
            r.scores.accuracy,
            r.scores.mean_class_accuracy,
            r.scores.calibration_error,
            r.label_ms,
            r.train_s,
            None if r.n_bytes is None else 1e-6 * r.n_bytes,
        )
        for r in results
    ]
    columns = ("accuracy", "mean-class", "ECE", "CPU ms per frame", "training CPU s", "model MB")
    print_table(("method", *columns), rows, title=title)
    if results:
        names = [r.method for r in results]
        by_class = [
            (c.label, c.n_frames, *(r.scores.by_class[k].recall for r in results))
            for k, c in enumerate(results[0].scores.by_class)
        ]
        print_table(("class", "tested", *names), by_class, title="Recall by class")
    for r in results:
        if r.svm_params is not None:
            typer.echo(f"{r.method}: {r.svm_params}.")
    for name, why in left_out.items():
        typer.echo(f"{name} is left out: {why}.")
    for file in files[:1]:
        typer.echo(f"Page: {file}; {len(files) - 1} confusion matrices in the same folder.")


def result_figures(result: SceneResult) -> dict[str, Any]:
    """Return the figures of a method for JSON."""
    from slam_bof.evaluation import roc

    scores = result.scores
    curves = roc(result.probabilities, result.true, scores.classes)
    return {
        "accuracy": scores.accuracy,
        "mean_class_accuracy": scores.mean_class_accuracy,
        "calibration_error": scores.calibration_error,
        "label_ms": result.label_ms,
        "train_s": result.train_s,
        "n_bytes": result.n_bytes,
        "grid_search": asdict(result.svm_params) if result.svm_params else None,
        "by_class": [asdict(of_class) for of_class in scores.by_class],
        "auc": {curve.label: curve.auc for curve in curves},
        "confusion": scores.confusion.tolist(),
    }
