"""The metrics of a run in the form of ``metrics.json``: flat, SI units, null where unknown."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from slam_bof import evaluation
from slam_bof.core import StageClock, Usage, peak_rss_mb
from slam_bof.geometry import se3
from slam_bof.run.record import RunRecord
from slam_bof.slam import LoopCloser, SlamResult
from slam_bof.types import Candidate, CandidateSource, EdgeKind, Scene, Trajectory

__all__ = [
    "Metrics",
    "compute_metrics",
    "cost_metrics",
    "count_metrics",
    "scene_metrics",
    "trajectory_metrics",
    "uncertainty_metrics",
]

Metrics = dict[str, str | int | float | None]

STAGES = ("read", "odometry", "track", "describe", "query", "verify", "optimize", "save", "total")


def compute_metrics(record: RunRecord) -> Metrics:
    """Return all metrics of a run."""
    result = record.result
    return {
        "dataset": record.dataset.name,
        "sequence": record.dataset.sequence,
        **count_metrics(result, record.closer, record.candidates),
        "groundtruth_offset_s": record.groundtruth_offset_s,
        **trajectory_metrics(result, record.live, record.groundtruth),
        **uncertainty_metrics(result, record.closer, record.groundtruth),
        **scene_metrics(result, record.smoothed, record.true_scenes),
        "n_regions": record.n_rooms,
        **cost_metrics(result, record.usage, record.clock),
        "session": record.closer.map.session,
        "seed": record.seed,
        "version": importlib.metadata.version("slam-bof"),
    }


def count_metrics(
    result: SlamResult, closer: LoopCloser, candidates: Sequence[Candidate]
) -> Metrics:
    """Return how many frames, keyframes, candidates and loops a run had."""
    loops = [loop for loop in result.loops if loop.kind == EdgeKind.LOOP]
    considered = [c for c in candidates if c.kind == EdgeKind.LOOP]
    return {
        "n_frames": len(result.optimized),
        "n_frames_skipped": result.n_skipped,
        "n_frames_resumed": result.n_resumed,
        "n_frames_repeated": result.n_repeated,
        "n_keyframes": len(result.keyframes),
        "n_odometry_lost": closer.n_odometry_lost,
        "n_frames_lost": closer.n_frames_lost,
        "n_components": closer.map.n_components,
        "n_candidates": len(considered),
        "n_verified": sum(not np.isnan(c.rmse_m) for c in considered),
        "n_global_registrations": closer.map.n_global_registrations,
        **{f"n_keyframes_{name}": n for name, n in asdict(closer.map.loop_counts).items()},
        "n_loops": len(loops),
        "n_loops_recognised": sum(loop.source != CandidateSource.PROXIMITY for loop in loops),
        "n_loops_rejected": len(considered) - len(loops),
        "n_loops_across": result.n_loops_across,
        "n_edges_left_out": len(result.loops_left_out),
        "n_covisibility_edges": len(result.loops) - len(loops),
        "n_partial_edges": sum(loop.kind == EdgeKind.PARTIAL for loop in result.loops),
    }


def trajectory_metrics(
    result: SlamResult, live: Trajectory | None, groundtruth: Trajectory | None
) -> Metrics:
    """Return the errors of trajectories and loops by ground truth, None where it is unknown.

    ``live`` has the poses of frames as they were known at the time, None if not all are known.
    ``groundtruth`` has a pose for each frame of the sequence.
    """
    if groundtruth is None:
        return dict.fromkeys(
            (
                *("ate_odometry_m", "ate_live_m", "ate_m", "ate_max_m"),
                *("rpe_odometry_m", "rpe_m"),
                *("loop_precision", "loop_recall", "covisibility_precision"),
            )
        )
    reference = Trajectory(groundtruth.stamps_s[result.indices], groundtruth.poses[result.indices])
    ate_odometry = evaluation.ate(result.odometry, reference)
    ate = evaluation.ate(result.optimized, reference)
    ate_live = evaluation.ate(live, reference) if live is not None else None
    keyframe_indices = [k.frame_index for k in result.keyframes]
    loops = [loop for loop in result.loops if loop.kind == EdgeKind.LOOP]
    edges = [loop for loop in result.loops if loop.kind == EdgeKind.COVISIBILITY]
    return {
        "ate_odometry_m": ate_odometry.rmse_m if ate_odometry else None,
        "ate_live_m": ate_live.rmse_m if ate_live else None,
        "ate_m": ate.rmse_m if ate else None,
        "ate_max_m": ate.max_m if ate else None,
        "rpe_odometry_m": evaluation.rpe(result.odometry, reference),
        "rpe_m": evaluation.rpe(result.optimized, reference),
        "loop_precision": evaluation.loop_precision(loops, keyframe_indices, reference),
        "loop_recall": evaluation.loop_recall(loops, keyframe_indices, reference),
        "covisibility_precision": evaluation.loop_precision(edges, keyframe_indices, reference),
    }


def uncertainty_metrics(
    result: SlamResult, closer: LoopCloser, groundtruth: Trajectory | None
) -> Metrics:
    """Return how well the covariances of keyframes and edges describe their errors.

    Keyframes are those in one component with the first; a session that was added to a map has
    none, because that lies in an earlier one.
    """
    names = ("keyframe_nees", "edge_nees")
    if groundtruth is None or closer.map.session or len(result.keyframes) < 2:
        return dict.fromkeys(names)
    truth = groundtruth.poses[result.indices[[k.frame_index for k in result.keyframes]]]
    joined = np.flatnonzero(closer.map.components == closer.map.components[0])
    others, poses = joined[1:], result.T_map_camera
    loops = [loop for loop in result.loops if loop.information.any()]  # not of culled keyframes
    T_match_query = np.array([loop.T_match_query for loop in loops]).reshape(-1, 4, 4)
    matches, queries = [loop.match_id for loop in loops], [loop.query_id for loop in loops]
    true_edges = se3.inverse(truth[matches]) @ truth[queries]
    keyframe_nees = evaluation.nees(
        se3.inverse(poses[0]) @ poses[others],
        se3.inverse(truth[0]) @ truth[others],
        closer.map.covariances()[others],
    )
    edge_nees = evaluation.nees(
        T_match_query, true_edges, closer.map.graph.uncertainty.of_edges(loops)
    )
    return dict(zip(names, (keyframe_nees, edge_nees), strict=True))


def scene_metrics(
    result: SlamResult, smoothed: Sequence[Scene | None], true_scenes: Sequence[str] | None
) -> Metrics:
    """Return the share of keyframes with the right label, None without true labels."""
    labels = {
        "scene_accuracy": [keyframe.scene for keyframe in result.keyframes],
        "scene_accuracy_smoothed": smoothed,
    }
    if true_scenes is None:
        return dict.fromkeys(labels)
    return {
        name: evaluation.scene_accuracy(
            [scene.label if scene else None for scene in scenes], true_scenes
        )
        for name, scenes in labels.items()
    }


def cost_metrics(result: SlamResult, usage: Usage, clock: StageClock) -> Metrics:
    """Return speed, time and memory of this process; stages are means per frame."""
    n_frames = len(result.optimized)
    seconds = dict(clock.seconds, total=usage.wall_s)
    return {
        "fps": n_frames / usage.wall_s,
        "cpu_s": usage.cpu_s,
        "wall_s": usage.wall_s,
        "peak_rss_mb": peak_rss_mb(),
        **{f"stage_ms.{name}": 1e3 * seconds.get(name, 0.0) / max(n_frames, 1) for name in STAGES},
        "descriptor_bytes_per_frame": _mean_bag_bytes(result),
    }


def _mean_bag_bytes(result: SlamResult) -> float:
    """Return the mean size of a keyframe's bag of words."""
    sizes = [k.bag.words.nbytes + k.bag.weights.nbytes for k in result.keyframes]
    return float(np.mean(sizes)) if sizes else 0.0
