"""A run on one HTML page: figures and a table, in one file that needs no network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam_bof import evaluation
from slam_bof.geometry import se3
from slam_bof.types import Array, Candidate, Keyframe, Loop, Pose, Trajectory
from slam_bof.visualization import html_page as page

__all__ = ["ReportData", "write_report"]


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """What a report shows.

    Parameters
    ----------
    metrics
        As in metrics.json; what is None is shown as not known.
    odometry, optimized
        ``T_odom_camera`` and ``T_map_camera`` of every frame processed, in that order.
    groundtruth
        ``T_world_camera``, paired with the frames by stamp; NaN where unknown.
    keyframes, loops, candidates
        In the order they came; a keyframe's ``frame_index`` counts the frames above.
    true_scenes
        The true label of each keyframe, None where unknown.
    """

    metrics: Mapping[str, str | int | float | None]
    odometry: Trajectory
    optimized: Trajectory
    groundtruth: Trajectory | None = None
    keyframes: Sequence[Keyframe] = ()
    loops: Sequence[Loop] = ()
    candidates: Sequence[Candidate] = ()
    true_scenes: Sequence[str | None] | None = None

    def __post_init__(self) -> None:
        """Check what must have the same length."""
        if len(self.odometry) != len(self.optimized):
            raise ValueError(
                f"trajectories must have the same frames, got {len(self.odometry)} of odometry "
                f"and {len(self.optimized)} optimized"
            )
        if self.true_scenes is not None and len(self.true_scenes) != len(self.keyframes):
            raise ValueError(
                f"true_scenes must have a label for each of {len(self.keyframes)} keyframes, "
                f"got {len(self.true_scenes)}"
            )


def write_report(path: Path | str, data: ReportData) -> None:
    """Write the page; the same data give the same bytes."""
    from plotly.offline import get_plotlyjs

    body = [page.cards(data.metrics), *_sections(data)]
    html = page.fill(
        title=str(data.metrics.get("sequence") or "Unnamed sequence"),
        subtitle=_subtitle(data),
        body="".join(body),
        script=get_plotlyjs(),
    )
    Path(path).write_text(html, encoding="utf-8", newline="\n")


def _subtitle(data: ReportData) -> str:
    stamps_s, metrics = data.optimized.stamps_s, data.metrics
    duration_s = float(stamps_s[-1] - stamps_s[0]) if len(stamps_s) else 0.0
    parts = [
        str(metrics.get("dataset") or ""),
        _count(len(stamps_s), "frame"),
        f"{duration_s:.1f} s",
        _count(len(data.keyframes), "keyframe"),
        f"slam_bof {metrics['version']}" if metrics.get("version") is not None else "",
        f"seed {metrics['seed']}" if metrics.get("seed") is not None else "",
    ]
    return " · ".join(part for part in parts if part)


def _sections(data: ReportData) -> Iterator[str]:
    truth = _truth_by_frame(data)
    yield _trajectory_section(data, truth)
    if truth is not None:
        yield _error_section(data, truth)
    considered = [c for c in data.candidates if c.kind == "loop"]
    if considered:
        yield _candidate_section(data, considered)
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
        text = "As in metrics.json, which has them in full precision."
        yield page.section("All figures", text, page.tables(data.metrics))


def _trajectory_section(data: ReportData, truth: Trajectory | None) -> str:
    from slam_bof.visualization import figures

    if truth is None:
        text = (
            "The camera's path as odometry alone has it, and after the loops have corrected it. "
            "No ground truth is known for this sequence."
        )
    else:
        text = (
            "The camera's path as odometry alone has it, and after the loops have corrected it, "
            "each aligned rigidly with ground truth, as the trajectory error (ATE) is measured."
        )
    poses = _poses(data, truth)
    T_level = _level(poses["optimized"])
    paths = {name: se3.transform(T_level, p[:, :3, 3]).round(4) for name, p in poses.items()}
    keyframes = paths["optimized"][_frame_indices(data)]
    links = _links(data, truth, keyframes)
    if "loop" in links:
        text += " Green lines join the two keyframes of each loop."
    return page.section(
        "Trajectory",
        f"{text} In all figures: drag to zoom or turn, double-click to reset.",
        _html(figures.draw_top_view(paths, links, keyframes), "top-view"),
        _html(figures.draw_trajectories(paths, links), "space-view"),
    )


def _error_section(data: ReportData, truth: Trajectory) -> str:
    from slam_bof.visualization import figures

    poses = _poses(data, truth)
    true = poses.pop("groundtruth")
    errors_m = {
        name: np.linalg.norm(p[:, :3, 3] - true[:, :3, 3], axis=1).round(5)
        for name, p in poses.items()
    }
    return page.section(
        "Position error",
        "How far each frame's position is from ground truth, after the same alignment.",
        _html(figures.draw_errors(_since_start(data, data.optimized.stamps_s), errors_m), "errors"),
    )


def _candidate_section(data: ReportData, considered: Sequence[Candidate]) -> str:
    from slam_bof.visualization import figures

    stamps_s = np.array([data.keyframes[c.query_id].stamp_s for c in considered])
    n_accepted = sum(c.decision == "accepted" for c in considered)
    n_near = sum(c.source == "proximity" for c in considered)
    figure = figures.draw_candidates(considered, _since_start(data, stamps_s))
    return page.section(
        "Loop candidates",
        f"{_count(len(considered), 'pair')} of keyframes considered, {n_accepted} accepted. "
        "Above, the score by which place recognition proposed a pair, relative to what a "
        f"neighbour in time scores; {n_near} pairs that the map itself proposed have none. "
        "Below, how far the two point clouds overlap, for pairs that came to be compared. "
        "Hover over a point to read why it was accepted or rejected.",
        _html(figure, "candidates"),
    )


def _label_section(data: ReportData) -> str:
    from slam_bof.visualization import figures

    stamps_s = np.array([keyframe.stamp_s for keyframe in data.keyframes])
    known = data.true_scenes is not None and any(s is not None for s in data.true_scenes)
    drawn = {
        "labels": [keyframe.scene for keyframe in data.keyframes],
        "smoothed": [keyframe.smoothed for keyframe in data.keyframes],
    }
    return page.section(
        "Scene labels",
        "The label of each keyframe by itself and, beside it, by those before and after as well; "
        "a larger point is a more probable label. "
        + ("Grey squares are the true labels." if known else "The true labels are not known."),
        *(
            _html(figures.draw_labels(_since_start(data, stamps_s), scenes, data.true_scenes), name)
            for name, scenes in drawn.items()
            if any(scene is not None for scene in scenes)
        ),
    )


def _stage_section(stage_ms: Mapping[str, float]) -> str:
    from slam_bof.visualization import figures

    return page.section(
        "Time",
        "Wall time of each stage, as a mean over the frames of the sequence. The total also "
        "holds what is not in a stage.",
        _html(figures.draw_stages(stage_ms), "stages"),
    )


def _truth_by_frame(data: ReportData) -> Trajectory | None:
    """Return the ground truth of each frame, NaN where unknown; None with too little of it."""
    if data.groundtruth is None:
        return None
    if evaluation.align_trajectory(data.optimized, data.groundtruth) is None:
        return None
    i, j = evaluation.associate(data.optimized, data.groundtruth)
    poses = np.full(data.optimized.poses.shape, np.nan)
    poses[i] = data.groundtruth.poses[j]
    return Trajectory(data.optimized.stamps_s, poses)


def _poses(data: ReportData, truth: Trajectory | None) -> dict[str, Array]:
    """Return what to draw, by name, (N, 4, 4) each, in the frame of the truth if there is one."""
    poses = {"odometry": data.odometry.poses, "optimized": data.optimized.poses}
    if truth is None:
        return poses
    known = np.isfinite(truth.poses).all(axis=(1, 2))
    for name, T_map_camera in poses.items():
        reference, estimate = (p[known, :3, 3] for p in (truth.poses, T_map_camera))
        poses[name] = se3.align(reference, estimate) @ T_map_camera
    return {**poses, "groundtruth": truth.poses}


def _links(data: ReportData, truth: Trajectory | None, keyframes: Array) -> dict[str, Array]:
    """Return the end points (L, 2, 3) of the edges by kind; loops that are wrong apart."""
    ids = np.array([(loop.match_id, loop.query_id) for loop in data.loops], dtype=np.intp)
    ends = keyframes[ids.reshape(-1, 2)]
    far = np.array([loop.kind == "loop" for loop in data.loops], dtype=bool)
    wrong = np.zeros(len(far), dtype=bool)
    if truth is not None:
        indices = _frame_indices(data)
        for i, loop in enumerate(data.loops):
            wrong[i] = far[i] and evaluation.loop_precision([loop], indices, truth) == 0.0
    links = {"covisibility": ends[~far], "loop": ends[far & ~wrong], "wrong": ends[wrong]}
    return {name: pairs for name, pairs in links.items() if len(pairs)}


def _level(T_world_camera: Array) -> Pose:
    """Find the frame to look at poses (N, 4, 4) in: x right, y forward, z up, first at 0.

    Up is where the cameras' tops point on the whole, forward where the first one looks.
    """
    if len(T_world_camera) == 0:
        return np.eye(4)
    up = -T_world_camera[:, :3, 1].mean(axis=0)
    forward = T_world_camera[0, :3, 2]
    if np.linalg.norm(np.cross(forward, up)) < 1e-6:
        up, forward = -T_world_camera[0, :3, 1], T_world_camera[0, :3, 2]
    up = up / np.linalg.norm(up)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    R = np.stack([right, np.cross(up, right), up])
    return se3.pose(R, -R @ T_world_camera[0, :3, 3])


def _frame_indices(data: ReportData) -> list[int]:
    return [keyframe.frame_index for keyframe in data.keyframes]


def _since_start(data: ReportData, stamps_s: Array) -> Array:
    start_s = data.optimized.stamps_s[0] if len(data.optimized) else 0.0
    return np.asarray(stamps_s - start_s).round(4)


def _html(figure: Any, div_id: str) -> str:
    html: str = figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        div_id=div_id,
        config={"displayModeBar": False, "responsive": True},
    )
    return html


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
