"""``slam-bof check``: whether depth and odometry fit, and what to set if they do not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam_bof.cli.inputs import open_sequence
from slam_bof.cli.options import DATASET, FRAMES, JSON, MAX_FRAMES, QUIET, SET

if TYPE_CHECKING:
    from slam_bof.cli.console import FrameBar
    from slam_bof.evaluation import Calibration
    from slam_bof.ports import Dataset
    from slam_bof.slam import Config
    from slam_bof.types import DepthFrame, Pose

__all__ = ["check"]

SURE = 3.0
"""Standard deviations from which a difference is more than chance."""
MIN_OFFSET_S, MIN_SCALE, MIN_TILT_DEG = 0.005, 0.005, 2.0
"""Smaller differences do not matter."""


def check(
    sequence: Annotated[Path, typer.Argument(help="Folder of a sequence of depth images.")],
    odometry: Annotated[
        Path | None,
        typer.Option(
            help="File with the odometry's trajectory, as the plug-in recorded reads it; by "
            "default the true poses of the sequence."
        ),
    ] = None,
    assignments: SET = None,
    dataset: DATASET = "auto",
    frames: FRAMES = None,
    max_frames: MAX_FRAMES = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Compare depth with odometry: clocks, unit of length and axes; say what to set.

    The poses must come from another sensor, such as a phone's tracking or motion capture. Set
    options of the trajectory with --set odometry.options.KEY=VALUE.
    """
    import numpy as np

    from slam_bof.cli.console import FrameBar
    from slam_bof.errors import DatasetError
    from slam_bof.evaluation import calibrate, measure_motions
    from slam_bof.slam import OdometryCheck, config as configs
    from slam_bof.types import Step, Trajectory

    config = configs.override(configs.resolve("indoor"), assignments or [])
    choice = config.dataset.model_copy(update={"name": dataset})
    opened, _ = open_sequence(sequence, choice, frames, quiet=quiet)
    visits: list[tuple[float, Pose]] = []
    tracked = OdometryCheck(config)
    with FrameBar(opened.sequence, quiet=quiet) as bar:

        def read() -> Iterator[tuple[DepthFrame, Pose]]:
            for index, (frame, T) in enumerate(_read(opened, odometry, config, max_frames, bar)):
                visits.append((frame.stamp_s, T))
                if np.isfinite(T).all():
                    tracked.add(frame, T)
                bar.on_step(index, Step(None, None, (), (), np.eye(4)))
                yield frame, T

        motions = measure_motions(read(), seed=config.seed)
    stamps_s, poses = zip(*visits, strict=True)
    found = calibrate(motions, Trajectory(np.array(stamps_s), np.array(poses)))
    # Where odometry is something else altogether, a fit of small differences says nothing.
    if doubts := tracked.doubts():
        raise DatasetError(f"{odometry or opened.sequence}: {'; '.join(doubts)}")
    _show(found, config.sensor.depth_scale, odometry, as_json=as_json)


def _read(
    dataset: Dataset, odometry: Path | None, config: Config, max_frames: int | None, bar: FrameBar
) -> Iterator[tuple[DepthFrame, Pose]]:
    """Read the frames, and the pose (4, 4) of each from odometry."""
    from slam_bof.core import registry
    from slam_bof.errors import DatasetError

    truth, recorded = dataset.groundtruth(), None
    if odometry is not None:
        options = {**config.odometry.options, "file": odometry}
        recorded = registry.build("odometry", "recorded", options)
    elif truth is None:
        raise DatasetError(f"{dataset.sequence}: found no true poses, expected --odometry FILE")
    n_frames = min(len(dataset), max_frames or len(dataset))
    bar.on_start(n_frames)
    for index in range(n_frames):
        frame = dataset.frame(index).corrected(config.sensor)
        if recorded is not None:
            yield frame, recorded.process(frame)
        elif truth is not None:
            yield frame, truth.poses[index]


def _show(
    found: Calibration | None, depth_scale: float, odometry: Path | None, *, as_json: bool
) -> None:
    import numpy as np

    from slam_bof.cli.console import print_json, print_table
    from slam_bof.errors import DatasetError

    if found is None:
        raise DatasetError(
            "found too little motion that depth holds, expected some 20 motions of 0.15 m or 6 "
            "degrees between views of rooms"
        )
    tilt_deg, tilt_sigma_deg = np.degrees(found.tilt_rad), np.degrees(found.tilt_sigma_rad)
    advice = _advice(found, depth_scale, odometry)
    knows_clock = np.isfinite(found.time_offset_sigma_s)
    if as_json:
        print_json(
            {
                "n_motions": found.n_motions,
                "time_offset_s": found.time_offset_s if knows_clock else None,
                "time_offset_sigma_s": found.time_offset_sigma_s if knows_clock else None,
                "depth_scale": found.depth_scale * depth_scale,
                "depth_scale_sigma": found.depth_scale_sigma * depth_scale,
                "tilt_deg": tilt_deg.tolist(),
                "tilt_sigma_deg": tilt_sigma_deg.tolist(),
                "advice": advice,
            }
        )
        return
    rows = [
        ("time offset of depth", f"{1e3 * found.time_offset_s:.1f} ms",
         f"{1e3 * found.time_offset_sigma_s:.1f} ms")
        if knows_clock
        else ("time offset of depth", "unknown", "poses too far apart"),
        ("scale of depth", f"{found.depth_scale:.4f}", f"{found.depth_scale_sigma:.4f}"),
        *((f"tilt about {axis}", f"{tilt:.2f} deg", f"{sigma:.2f} deg")
          for axis, tilt, sigma in zip("xyz", tilt_deg, tilt_sigma_deg, strict=True)),
    ]  # fmt: skip
    title = f"Depth against odometry, {found.n_motions} motions"
    print_table(("", "value", "sigma"), rows, title=title)
    for line in advice or ["Nothing needs to be set."]:
        typer.echo(line)


def _advice(found: Calibration, depth_scale: float, odometry: Path | None) -> list[str]:
    """Return what to set, in whole sentences."""
    import numpy as np

    advice = []
    if abs(found.time_offset_s) > max(MIN_OFFSET_S, SURE * found.time_offset_sigma_s):
        ms = 1e3 * found.time_offset_s
        advice.append(
            f"Depth is {abs(ms):.0f} ms {'behind' if ms < 0 else 'ahead of'} odometry's clock: set "
            f"--set odometry.options.offset_s={-found.time_offset_s:.4f}"
            + (
                ""
                if odometry
                else " for a recorded odometry with these poses, and "
                f"--set groundtruth_offset_s={-found.time_offset_s:.4f} to judge a run by them"
            )
        )
    if abs(found.depth_scale - 1.0) > max(MIN_SCALE, SURE * found.depth_scale_sigma):
        advice.append(
            "Depth has another unit of length than odometry: set "
            f"--set sensor.depth_scale={found.depth_scale * depth_scale:.4f}"
        )
    tilt_deg = np.degrees(np.abs(found.tilt_rad))
    if (tilt_deg > np.maximum(MIN_TILT_DEG, SURE * np.degrees(found.tilt_sigma_rad))).any():
        advice.append(
            "The axes of odometry are not those of the depth camera: calibrate the rotation "
            "between the two, or look at odometry.options.convention."
        )
    return advice
