"""The figures of a run, as ``metrics.json`` has them: flat, SI units, null where unknown."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from slam_bof import evaluation
from slam_bof.core import StageClock, Usage, peak_rss_mb
from slam_bof.slam import LoopCloser, SlamResult
from slam_bof.types import Candidate, Scene, Trajectory

__all__ = ["Metrics", "compute_metrics"]

Metrics = dict[str, str | int | float | None]

STAGES = ("read", "odometry", "track", "describe", "query", "verify", "optimize", "save", "total")


def compute_metrics(
    *,
    dataset_name: str,
    sequence: str,
    result: SlamResult,
    closer: LoopCloser,
    candidates: Sequence[Candidate],
    groundtruth: Trajectory | None,
    true_scenes: Sequence[str] | None,
    smoothed: Sequence[Scene | None],
    n_regions: int,
    usage: Usage,
    clock: StageClock,
    seed: int,
) -> Metrics:
    """Collect everything that can be known of a run.

    ``candidates`` is the audit trail; ``groundtruth`` has a pose for each frame of the
    sequence, ``true_scenes`` a label for each keyframe, ``smoothed`` what the whole trajectory
    says of each. All are of this session, and times are those of this process.
    """
    n_frames = len(result.optimized)
    loops = [loop for loop in result.loops if loop.kind == "loop"]
    considered = [c for c in candidates if c.kind == "loop"]
    verified = [c for c in considered if not np.isnan(c.rmse_m)]
    seconds = dict(clock.seconds, total=usage.wall_s)
    metrics: Metrics = {
        "dataset": dataset_name,
        "sequence": sequence,
        "n_frames": n_frames,
        "n_frames_skipped": result.n_skipped,
        "n_frames_resumed": result.n_resumed,
        "n_keyframes": len(result.keyframes),
        "n_odometry_lost": closer.n_odometry_lost,
        "n_frames_lost": closer.n_frames_lost,
        "n_parts": closer.n_parts,
        "n_candidates": len(considered),
        "n_verified": len(verified),
        **{f"n_keyframes_{name}": n for name, n in asdict(closer.loop_counts).items()},
        "n_loops": len(loops),
        "n_loops_recognised": sum(loop.source != "proximity" for loop in loops),
        "n_loops_rejected": len(considered) - len(loops),
        "n_loops_across": result.n_loops_across,
        "n_edges_left_out": len(result.loops_left_out),
        "n_covisibility_edges": len(result.loops) - len(loops),
        "ate_odometry_m": None,
        "ate_m": None,
        "ate_max_m": None,
        "rpe_odometry_m": None,
        "rpe_m": None,
        "loop_precision": None,
        "loop_recall": None,
        "covisibility_precision": None,
        "scene_accuracy": None,
        "scene_accuracy_smoothed": None,
        "n_regions": n_regions,
        "fps": n_frames / usage.wall_s,
        "cpu_s": usage.cpu_s,
        "wall_s": usage.wall_s,
        "peak_rss_mb": peak_rss_mb(),
        **{f"stage_ms.{name}": 1e3 * seconds.get(name, 0.0) / max(n_frames, 1) for name in STAGES},
        "descriptor_bytes_per_frame": _descriptor_bytes(result),
        "session": closer.session,
        "seed": seed,
        "version": importlib.metadata.version("slam-bof"),
    }
    if groundtruth is not None:
        metrics |= _against_groundtruth(result, groundtruth)
    if true_scenes is not None:
        metrics["scene_accuracy"] = evaluation.scene_accuracy(
            [k.scene.label if k.scene else None for k in result.keyframes],
            true_scenes,
        )
        metrics["scene_accuracy_smoothed"] = evaluation.scene_accuracy(
            [scene.label if scene else None for scene in smoothed], true_scenes
        )
    return metrics


def _against_groundtruth(result: SlamResult, groundtruth: Trajectory) -> Metrics:
    reference = Trajectory(groundtruth.stamps_s[result.indices], groundtruth.poses[result.indices])
    ate_odometry = evaluation.ate(result.odometry, reference)
    ate = evaluation.ate(result.optimized, reference)
    keyframe_indices = [k.frame_index for k in result.keyframes]
    loops = [loop for loop in result.loops if loop.kind == "loop"]
    edges = [loop for loop in result.loops if loop.kind == "covisibility"]
    return {
        "ate_odometry_m": ate_odometry.rmse_m if ate_odometry else None,
        "ate_m": ate.rmse_m if ate else None,
        "ate_max_m": ate.max_m if ate else None,
        "rpe_odometry_m": evaluation.rpe(result.odometry, reference),
        "rpe_m": evaluation.rpe(result.optimized, reference),
        "loop_precision": evaluation.loop_precision(loops, keyframe_indices, reference),
        "covisibility_precision": evaluation.loop_precision(edges, keyframe_indices, reference),
        "loop_recall": evaluation.loop_recall(loops, keyframe_indices, reference),
    }


def _descriptor_bytes(result: SlamResult) -> float:
    """Return the mean size of a keyframe's bag."""
    sizes = [k.bag.words.nbytes + k.bag.weights.nbytes for k in result.keyframes]
    return float(np.mean(sizes)) if sizes else 0.0
