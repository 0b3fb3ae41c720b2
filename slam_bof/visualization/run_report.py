"""The report of a run: one HTML file with figures and tables that needs no network."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import (
    Array,
    Candidate,
    CandidateSource,
    Decision,
    EdgeKind,
    Trajectory,
)
from slam_bof.visualization import html_page as page
from slam_bof.visualization.depth_pictures import MAX_DEPTH_M, depth_picture
from slam_bof.visualization.report_data import PicturedPair, ReportData
from slam_bof.visualization.report_paths import (
    aligned_poses,
    by_component,
    level_axes,
    loop_links,
    loop_texts,
    truth_by_frame,
)

__all__ = ["write_report"]

MAX_WARNINGS = 20
"""Number of warnings that the report shows."""
N_REASONS = 15
"""Number of reasons that the report counts."""


def write_report(path: Path | str, data: ReportData) -> None:
    """Write the report; the same data give the same bytes."""
    from plotly.offline import get_plotlyjs

    body = [page.cards(data.metrics), *_sections(data)]
    html = page.render_page(
        title=str(data.metrics.get("sequence") or "Unnamed sequence"),
        subtitle=_subtitle(data),
        body="".join(body),
        script=get_plotlyjs(),
    )
    Path(path).write_text(html, encoding="utf-8", newline="\n")


def _subtitle(data: ReportData) -> str:
    stamps_s, metrics = data.optimized.stamps_s, data.metrics
    duration_s = float(stamps_s[-1] - stamps_s[0]) if len(stamps_s) else 0.0
    items = [
        str(metrics.get("dataset") or ""),
        _count(len(stamps_s), "frame"),
        f"{duration_s:.1f} s",
        _count(len(data.keyframes), "keyframe"),
        f"slam_bof {metrics['version']}" if metrics.get("version") is not None else "",
        f"seed {metrics['seed']}" if metrics.get("seed") is not None else "",
    ]
    return " · ".join(item for item in items if item)


def _sections(data: ReportData) -> Iterator[str]:
    truth = truth_by_frame(data)
    if data.warnings:
        yield _warning_section(data.warnings)
    if data.plans:
        yield _plan_section(data)
    yield _trajectory_section(data, truth)
    if truth is not None:
        yield _error_section(data, truth)
    if len(data.health) == len(data.optimized) > 0:
        yield _health_section(data)
    considered = [c for c in data.candidates if c.kind == EdgeKind.LOOP]
    if considered:
        yield _candidate_section(data, considered)
    for decision in (Decision.ACCEPTED, Decision.REJECTED):
        if pairs := [pair for pair in data.pairs if pair.candidate.decision == decision]:
            yield _pair_section(decision, pairs)
    if any(keyframe.scene is not None for keyframe in data.keyframes):
        yield _label_section(data)
    prefix = "stage_ms."
    stage_ms = {
        key.removeprefix(prefix): float(value)
        for key, value in data.metrics.items()
        if key.startswith(prefix) and isinstance(value, int | float)
    }
    if stage_ms:
        yield _stage_section(stage_ms)
    if data.metrics:
        text = "The content of metrics.json, rounded."
        yield page.section("All metrics", text, page.tables(data.metrics))
    if data.command or data.configuration:
        yield page.section(
            "How it was made",
            "The same command and configuration give the same bytes.",
            page.details(data.command or "The configuration", data.configuration),
        )


def _warning_section(warnings: Sequence[str]) -> str:
    left_out = len(warnings) - MAX_WARNINGS
    text = "What the run has warned of"
    text += f"; {left_out} more are in run.log." if left_out > 0 else "."
    return page.section("Warnings", text, page.listed(warnings[:MAX_WARNINGS]))


def _plan_section(data: ReportData) -> str:
    from slam_bof.visualization.plan_figure import draw_plan

    text = (
        "The place from above: walls and furniture are dark, what was seen to be free is light, "
        "in the colour of its room, and what was not seen is grey. Points are keyframes."
    )
    text += _note_on_components(data, "each has a plan of its own, the largest first")
    names = ("plan", *(f"plan-{n}" for n in range(2, len(data.plans) + 1)))
    figures = [
        page.figure_html(draw_plan(plan), name)
        for plan, name in zip(data.plans, names, strict=True)
    ]
    return page.section("Place", text, "".join(figures))


def _note_on_components(data: ReportData, how: str) -> str:
    """Return a sentence to be added where the map has several components."""
    n_components = data.metrics.get("n_components")
    if not (isinstance(n_components, int) and n_components > 1):
        return ""
    return (
        f" The map has {n_components} components that no loop has joined, and how they lie to each "
        f"other is unknown: {how}."
    )


def _health_section(data: ReportData) -> str:
    from slam_bof.visualization import report_figures as figures

    n_open = np.array([frame.n_open for frame in data.health])
    is_lost = np.array([frame.health == "lost" for frame in data.health])
    times_s = _since_start(data, data.optimized.stamps_s)
    counts = Counter(frame.health for frame in data.health)
    listed = ", ".join(f"{n} {health}" for health, n in counts.most_common())
    return page.section(
        "Tracking",
        f"Of {len(data.health)} frames: {listed}. In a degenerate frame the surfaces in sight "
        "leave directions open, along which the pose is that of odometry; in a lost one odometry "
        "contradicts what is seen.",
        page.figure_html(figures.draw_health(times_s, n_open, is_lost), "health"),
    ) + _uncertainty_section(data, times_s, is_lost)


def _uncertainty_section(data: ReportData, times_s: Array, is_lost: Array) -> str:
    from slam_bof.visualization import report_figures as figures

    sigma_m, sigma_rad = (
        np.where(is_lost, np.nan, [getattr(frame, name) for frame in data.health])
        for name in ("sigma_m", "sigma_rad")
    )
    if np.isnan(sigma_m).all():
        return ""
    return page.section(
        "Uncertainty",
        "How far each frame may be off in the map as it was known at the time, relative to the "
        "first keyframe of its component, as one standard deviation over all axes. It grows with "
        "the way, falls where a loop closes a circle, and is large where directions are open.",
        page.figure_html(figures.draw_uncertainty(times_s, sigma_m, sigma_rad), "uncertainty"),
    )


def _trajectory_section(data: ReportData, truth: Trajectory | None) -> str:
    from slam_bof.visualization import trajectory_figures as figures

    if truth is None:
        text = (
            "The path of the camera by odometry alone, and after correction by loops. "
            "The ground truth of this sequence is unknown."
        )
    else:
        text = (
            "The path of the camera by odometry alone, and after correction by loops, each "
            "rigidly aligned with ground truth, as for the absolute trajectory error (ATE)."
        )
    text += _note_on_components(data, "each has a colour of its own")
    poses = aligned_poses(data, truth)
    T_level = level_axes(poses["optimized"])
    paths = {name: se3.transform(T_level, p[:, :3, 3]).round(4) for name, p in poses.items()}
    keyframes = paths["optimized"][data.frame_indices]
    links = loop_links(data, truth, keyframes)
    if "loop" in links:
        text += (
            " Green lines join the two keyframes of a loop; hover over a keyframe to see all of "
            "its loops."
        )
    paths |= by_component(paths["optimized"], data)
    return page.section(
        "Trajectory",
        f"{text} In all figures: drag to zoom or turn, double-click to reset.",
        page.figure_html(
            figures.draw_top_view(paths, links, keyframes, loop_texts(data)), "top-view"
        ),
        page.figure_html(figures.draw_trajectories(paths, links), "space-view"),
    )


def _error_section(data: ReportData, truth: Trajectory) -> str:
    from slam_bof.visualization import trajectory_figures as figures

    poses = aligned_poses(data, truth)
    true = poses.pop("groundtruth")
    errors_m = {
        name: np.linalg.norm(p[:, :3, 3] - true[:, :3, 3], axis=1).round(5)
        for name, p in poses.items()
    }
    times_s = _since_start(data, data.optimized.stamps_s)
    return page.section(
        "Position error",
        "Distance of each frame's position from ground truth, after the same alignment.",
        page.figure_html(figures.draw_errors(times_s, errors_m), "errors"),
    )


def _candidate_section(data: ReportData, considered: Sequence[Candidate]) -> str:
    from slam_bof.visualization import report_figures as figures

    stamps_s = np.array([data.keyframes[c.query_id].stamp_s for c in considered])
    n_accepted = sum(c.decision == Decision.ACCEPTED for c in considered)
    n_near = sum(c.source == CandidateSource.PROXIMITY for c in considered)
    figure = figures.draw_candidates(considered, _since_start(data, stamps_s))
    reasons = _count_reasons(considered)
    histogram = page.figure_html(figures.draw_reasons(reasons), "reasons") if reasons else ""
    return page.section(
        "Loop candidates",
        f"{_count(len(considered), 'pair')} of keyframes considered, {n_accepted} accepted. "
        "Above: the score with which place recognition proposed a pair; "
        f"{n_near} pairs proposed because they are near in the map have none. "
        "Below: the overlap of the two keyframes, for pairs that were verified. "
        "Hover over a point to see the reason for the decision. Below that: how often pairs were "
        "not accepted for which reason.",
        page.figure_html(figure, "candidates") + histogram,
    )


def _pair_section(decision: Decision, pairs: Sequence[PicturedPair]) -> str:
    return page.section(
        f"Loops {decision}",
        "Some of the pairs, evenly chosen: the keyframe, and beside it the older one that it was "
        f"compared with. Depth from 0 (dark) to {MAX_DEPTH_M:g} m (bright); black where it is "
        "missing.",
        *(depth_picture(pair.depth_m, _describe(pair.candidate)) for pair in pairs),
    )


def _describe(candidate: Candidate) -> str:
    reason = f": {candidate.reason}" if candidate.reason else ""
    return f"keyframes {candidate.query_id} and {candidate.match_id}{reason}"


def _count_reasons(considered: Sequence[Candidate]) -> dict[str, int]:
    """Return how many pairs have each reason, the most frequent first; numbers are left out.

    Reasons with a number each, such as an overlap, count as one.
    """
    reasons = Counter(
        re.sub(r"\d+(?:\.\d+)?", "…", candidate.reason)
        for candidate in considered
        if candidate.reason and candidate.decision != Decision.ACCEPTED
    )
    return dict(reasons.most_common(N_REASONS))


def _label_section(data: ReportData) -> str:
    from slam_bof.visualization import report_figures as figures

    times_s = _since_start(data, np.array([keyframe.stamp_s for keyframe in data.keyframes]))
    known = data.true_scenes is not None and any(s is not None for s in data.true_scenes)
    drawn = {
        "labels": [keyframe.scene for keyframe in data.keyframes],
        "smoothed": [keyframe.smoothed for keyframe in data.keyframes],
    }
    return page.section(
        "Scene labels",
        "The label of each keyframe's image and, in the second figure, the label smoothed over "
        "neighbouring keyframes. Larger points are more probable labels. "
        + ("Grey squares are the true labels." if known else "The true labels are unknown."),
        *(
            page.figure_html(figures.draw_labels(times_s, scenes, data.true_scenes), name)
            for name, scenes in drawn.items()
            if any(scene is not None for scene in scenes)
        ),
    )


def _stage_section(stage_ms: Mapping[str, float]) -> str:
    from slam_bof.visualization import report_figures as figures

    return page.section(
        "Time",
        "Wall time of each stage, as a mean over the frames of the sequence. The total includes "
        "time outside the stages.",
        page.figure_html(figures.draw_stages(stage_ms), "stages"),
    )


def _since_start(data: ReportData, stamps_s: Array) -> Array:
    start_s = data.optimized.stamps_s[0] if len(data.optimized) else 0.0
    return np.asarray(stamps_s - start_s).round(4)


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
