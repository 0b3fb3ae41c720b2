"""A comparison of scene labelling methods as an HTML page, with confusion matrices as PNG."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from slam_bof.evaluation import SceneResult, reliability, roc
from slam_bof.visualization import matrix_images as matrices
from slam_bof.visualization.html_page import figure_html, render_page, section

__all__ = ["write_comparison"]

COLUMNS = (
    ("accuracy", "{:.3f}"),
    ("mean-class accuracy", "{:.3f}"),
    ("calibration error", "{:.3f}"),
    ("CPU ms per frame", "{:.1f}"),
    ("training, CPU s", "{:.1f}"),
    ("model, MB", "{:.2f}"),
)


def write_comparison(
    folder: Path,
    results: Sequence[SceneResult],
    left_out: Mapping[str, str],
    *,
    title: str,
    subtitle: str,
) -> list[Path]:
    """Write ``scenes.html`` and ``confusion_METHOD.png`` for every method to a folder.

    Returns the paths of the files, the page first.
    """
    from plotly.offline import get_plotlyjs

    folder.mkdir(parents=True, exist_ok=True)
    text = "All methods are trained and tested with the same frames."
    text += "".join(f" {name} is left out: {why}." for name, why in left_out.items())
    body = [section("Methods", text, _table(results))]
    body += _figures(results)
    page = folder / "scenes.html"
    html = render_page(title=title, subtitle=subtitle, body="".join(body), script=get_plotlyjs())
    page.write_text(html, encoding="utf-8", newline="\n")
    files = [page]
    for result in results:
        scores = result.scores
        image = matrices.draw_confusion(
            scores.confusion, scores.classes, title=f"{title}: {result.method}"
        )
        files.append(folder / f"confusion_{re.sub('[^a-z0-9-]', '_', result.method)}.png")
        matrices.write_png(files[-1], image)
    return files


def _figures(results: Sequence[SceneResult]) -> list[str]:
    from slam_bof.visualization.scene_figures import draw_confusion, draw_reliability, draw_roc

    sections = []
    bins = {}
    for number, result in enumerate(results):
        scores = result.scores
        curves = roc(result.probabilities, result.true, scores.classes)
        figures = [
            figure_html(draw_confusion(scores.confusion, scores.classes), f"confusion-{number}")
        ]
        if curves:
            figures.append(figure_html(draw_roc(curves), f"roc-{number}"))
        text = (
            f"{len(result.true)} test frames. Left: confusion of true class (row) and predicted "
            "class (column). Right: ROC curve of each class, with the area under the curve."
        )
        sections.append(section(result.method, text, *figures))
        right = result.probabilities.argmax(axis=1) == [
            scores.classes.index(label) for label in result.true
        ]
        bins[result.method] = reliability(result.probabilities.max(axis=1), right)
    text = "On the diagonal, 70 % of the labels with a predicted probability of 0.7 are correct."
    diagram = figure_html(draw_reliability(bins), "reliability")
    sections.insert(0, section("Calibration", text, diagram))
    return sections


def _table(results: Sequence[SceneResult]) -> str:
    head = "".join(f"<td>{escape(name)}</td>" for name, _ in COLUMNS)
    rows = [f"<tr><th>method</th>{head}</tr>"]
    for result in results:
        values = (
            result.scores.accuracy,
            result.scores.mean_class_accuracy,
            result.scores.calibration_error,
            result.label_ms,
            result.train_s,
            None if result.n_bytes is None else 1e-6 * result.n_bytes,
        )
        cells = (
            f"<td>{'' if value is None else form.format(value)}</td>"
            for (_, form), value in zip(COLUMNS, values, strict=True)
        )
        rows.append(f"<tr><th>{escape(result.method)}</th>{''.join(cells)}</tr>")
    return f"<table>{''.join(rows)}</table>"
