"""``slam-bof demo``: the mini-SLAM on a synthetic flat."""

from __future__ import annotations

import os
from pathlib import Path

from slam_bof.cli.options import JSON, MAX_FRAMES, OUT, QUIET, SEED
from slam_bof.cli.run import run_new

__all__ = ["demo"]


def demo(
    out: OUT = Path("runs"),
    seed: SEED = 0,
    max_frames: MAX_FRAMES = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Run the mini-SLAM over a tour of a synthetic flat, which is made once and cached."""
    from slam_bof import synthetic
    from slam_bof.cli.console import Bar
    from slam_bof.run import RunOptions
    from slam_bof.slam import config as configs

    # A shortened tour has a folder of its own, so that it does not replace the whole one.
    folder = _cache() / (f"seed-{seed}" + (f"-first-{max_frames}" if max_frames else ""))
    with Bar("Making a flat", quiet=quiet) as bar:
        sequence = synthetic.write_flat(folder, seed=seed, n_frames=max_frames, progress=bar.show)
    # The flat is drawn, as are the rooms that this model has learnt from and is right about.
    config = configs.preset("indoor").model_copy(update={"seed": seed, "model": "synthetic"})
    options = RunOptions(max_frames=max_frames, with_color=True)
    run_new(sequence, config, out, options, quiet=quiet, as_json=as_json)


def _cache() -> Path:
    """Return the folder for data that can be made again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "slam_bof"
