"""The HTML of reports: the page, its sections, headline values and tables of metrics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from html import escape
from string import Template
from typing import Any

__all__ = ["Metrics", "cards", "details", "figure_html", "render_page", "section", "tables"]

Metrics = Mapping[str, str | int | float | None]

TABLES: dict[str, dict[str, tuple[str, str]]] = {
    "Trajectory": {
        "groundtruth_offset_s": ("time added to the stamps of true poses", "{:.4f} s"),
        "ate_odometry_m": ("ATE of odometry alone (RMSE)", "{:.4f} m"),
        "ate_live_m": ("ATE of poses as they were known at the time (RMSE)", "{:.4f} m"),
        "ate_m": ("ATE with loops (RMSE)", "{:.4f} m"),
        "ate_max_m": ("largest error with loops", "{:.4f} m"),
        "rpe_odometry_m": ("RPE of odometry alone, 30 frames (RMSE)", "{:.4f} m"),
        "rpe_m": ("RPE with loops, 30 frames (RMSE)", "{:.4f} m"),
        "keyframe_nees": ("normalised squared error of keyframes (1: as uncertain)", "{:.2f}"),
        "edge_nees": ("normalised squared error of edges", "{:.2f}"),
        "n_odometry_lost": ("losses of odometry", "{}"),
        "n_frames_lost": ("frames without a pose in the map", "{}"),
        "n_components": ("map components, which no loop connects", "{}"),
        "session": ("number of the session in its map", "{}"),
    },
    "Loops and labels": {
        "n_candidates": ("pairs considered", "{}"),
        "n_verified": ("of these, registered by geometric verification", "{}"),
        "n_keyframes_candidate": ("keyframes with a candidate (Table 10)", "{}"),
        "n_keyframes_approved": ("of these, approved: consistent in time", "{}"),
        "n_keyframes_between": ("keyframes between the thresholds", "{}"),
        "n_keyframes_discarded": ("keyframes discarded: no score above the threshold", "{}"),
        "n_keyframes_unjudged": ("keyframes not decided: normaliser too low", "{}"),
        "n_loops": ("loops accepted", "{}"),
        "n_loops_recognised": ("of these, found by place recognition", "{}"),
        "n_loops_rejected": ("pairs rejected", "{}"),
        "n_edges_left_out": ("accepted edges left out by the final optimisation", "{}"),
        "n_loops_across": ("loops to earlier sessions", "{}"),
        "n_covisibility_edges": ("covisibility edges", "{}"),
        "n_partial_edges": ("of these, edges that leave directions open", "{}"),
        "covisibility_precision": (
            "covisibility edges within 0.10 m and 5° of ground truth",
            "{:.1%}",
        ),
        "n_global_registrations": ("pairs registered without an initial pose", "{}"),
        "loop_precision": ("loops within 0.10 m and 5° of ground truth", "{:.1%}"),
        "loop_recall": ("revisiting keyframes with an accepted loop", "{:.1%}"),
        "scene_accuracy": ("keyframes with the correct label of the single image", "{:.1%}"),
        "scene_accuracy_smoothed": ("keyframes with the correct smoothed label", "{:.1%}"),
        "n_regions": ("rooms found", "{}"),
    },
    "Input and cost": {
        "n_frames": ("frames", "{}"),
        "n_frames_skipped": ("frames skipped as unreadable", "{}"),
        "n_frames_resumed": ("frames restored from an interrupted run", "{}"),
        "n_keyframes": ("keyframes", "{}"),
        "fps": ("frames per second, overall", "{:.1f}"),
        "cpu_s": ("processor time", "{:.1f} s"),
        "wall_s": ("wall time", "{:.1f} s"),
        "peak_rss_mb": ("peak memory", "{:.0f} MB"),
        "descriptor_bytes_per_frame": ("size of a keyframe's descriptor", "{:.0f} bytes"),
    },
}
"""The metrics under each heading: key, name and format."""

IN_HEADER = ("dataset", "sequence", "version", "seed")
UNKNOWN = "unknown"


def render_page(*, title: str, subtitle: str, body: str, script: str) -> str:
    """Return the whole page; ``body`` and ``script`` are HTML and JavaScript already."""
    return PAGE.substitute(title=escape(title), subtitle=escape(subtitle), body=body, script=script)


def section(heading: str, text: str, *figures: str) -> str:
    """Return a section with a heading, an explanation and figures (HTML)."""
    # The number of columns is set before a figure is drawn, since it takes the present width.
    cells = "".join(f"<div>{figure}</div>" for figure in figures)
    return (
        f"<section><h2>{escape(heading)}</h2><p>{escape(text)}</p>"
        f'<div class="figures columns-{len(figures)}">{cells}</div></section>\n'
    )


def listed(items: Iterable[str]) -> str:
    """Return a list of texts."""
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def details(summary: str, text: str) -> str:
    """Return preformatted text that opens when its summary is clicked."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def figure_html(figure: Any, div_id: str) -> str:
    """Return a plotly figure as HTML, for a page with plotly's script."""
    html: str = figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        div_id=div_id,
        config={"displayModeBar": False, "responsive": True},
    )
    return html


def cards(metrics: Metrics) -> str:
    """Return the headline values as cards."""
    ate = _write(metrics, "ate_m", "{:.3f} m")
    before = _note(metrics, "ate_odometry_m", "odometry alone: {:.3f} m")
    correct = _note(metrics, "loop_precision", "correct by ground truth: {:.0%}")
    if metrics.get("n_loops") == 0:
        correct = "none to compare with ground truth"
    headlines = [
        ("Trajectory error", ate, before),
        ("Loops accepted", _write(metrics, "n_loops", "{}"), correct),
        (
            "Correct scene labels",
            _write(metrics, "scene_accuracy", "{:.0%}"),
            "of single keyframes",
        ),
        ("Speed", _write(metrics, "fps", "{:.1f} fps"), "from reading to trajectory"),
        ("Peak memory", _write(metrics, "peak_rss_mb", "{:.0f} MB"), "of the whole process"),
    ]
    return '<div class="cards">' + "".join(_card(*headline) for headline in headlines) + "</div>\n"


def tables(metrics: Metrics) -> str:
    """Return all metrics as tables; metrics without a name are listed by their key."""
    named = {key for rows in TABLES.values() for key in rows}
    others = {
        key: (key, "{}")
        for key in metrics
        if key not in named and key not in IN_HEADER and not key.startswith("stage_ms.")
    }
    return '<div class="tables">' + "".join(_tables(metrics, others)) + "</div>\n"


def _tables(metrics: Metrics, others: dict[str, tuple[str, str]]) -> Iterator[str]:
    for heading, names in [*TABLES.items(), ("Others", others)]:
        rows = [
            f"<tr><th>{escape(name)}</th><td>{escape(_write(metrics, key, form))}</td></tr>"
            for key, (name, form) in names.items()
            if key in metrics
        ]
        if rows:
            yield f"<table><caption>{heading}</caption>{''.join(rows)}</table>"


def _card(name: str, value: str, note: str) -> str:
    kind = "value unknown" if value == UNKNOWN else "value"
    return (
        f'<div class="card"><div class="name">{escape(name)}</div>'
        f'<div class="{kind}">{escape(value)}</div><div class="note">{escape(note)}</div></div>'
    )


def _note(metrics: Metrics, key: str, form: str) -> str:
    return "no ground truth" if metrics.get(key) is None else _write(metrics, key, form)


def _write(metrics: Metrics, key: str, form: str) -> str:
    value = metrics.get(key)
    if value is None:
        return UNKNOWN
    return str(value) if isinstance(value, str) else form.format(value)


PAGE = Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title · slam_bof</title>
<style>
:root { --text: #23282f; --soft: #667080; --line: #e3e7ec; --back: #f5f6f8; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--text); font: 15px/1.5 system-ui,
  -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 36px 24px 48px; }
h1 { font-size: 26px; font-weight: 650; margin: 0; letter-spacing: -0.01em; }
h2 { font-size: 17px; font-weight: 620; margin: 0 0 4px; }
p { margin: 0; max-width: 82ch; color: var(--soft); }
header p { margin: 4px 0 22px; }
section, .card { background: white; border: 1px solid var(--line); border-radius: 10px; }
section { padding: 20px 24px; margin-top: 18px; }
.cards { display: grid; gap: 14px; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); }
.card { padding: 14px 18px; }
.card .name, .card .note { font-size: 13px; color: var(--soft); }
.card .value { font-size: 25px; font-weight: 620; line-height: 1.35;
  font-variant-numeric: tabular-nums; }
.card .unknown { color: var(--soft); font-size: 19px; font-weight: 400; line-height: 34px; }
.figures { display: grid; gap: 16px; margin-top: 10px; }
@media (min-width: 960px) { .columns-2 { grid-template-columns: 1fr 1fr; } }
.figures > div { min-width: 0; }
.columns-3, .columns-4, .columns-5, .columns-6 { grid-template-columns: repeat(3, 1fr); }
figure { margin: 0; }
img { width: 100%; border-radius: 4px; }
figcaption { font-size: 13px; color: var(--soft); }
.tables { display: grid; gap: 8px 36px; margin-top: 14px; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(330px, 100%), 1fr)); }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
caption { text-align: left; font-weight: 620; padding: 6px 0; }
th, td { padding: 5px 0; border-top: 1px solid var(--line); vertical-align: top; }
th { text-align: left; font-weight: 400; color: var(--soft); padding-right: 16px; }
td { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
@media print { body { background: white; } section { break-inside: avoid; } }
</style>
<script>$script</script>
</head>
<body>
<main>
<header><h1>$title</h1><p>$subtitle</p></header>
$body</main>
</body>
</html>
""")
