"""The folder of a run: created, linked to its map, logged to, and read back."""

from __future__ import annotations

import itertools
import json
import logging
import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from slam_bof.core import read_text
from slam_bof.errors import RunError
from slam_bof.geometry import read_tum
from slam_bof.run.health import read_health
from slam_bof.run.logging_observer import read_warnings
from slam_bof.run.pictures import picture_pairs
from slam_bof.run.plan import read_plans
from slam_bof.slam import of_session
from slam_bof.store import MapStore, components_of
from slam_bof.visualization import ReportData

__all__ = [
    "as_run_errors",
    "link_map",
    "logging_to",
    "make_folder",
    "read_run",
    "rerun_command",
]

logger = logging.getLogger(__name__)


def make_folder(out: Path) -> Path:
    """Create ``out``/<time stamp> and let the link ``out``/latest point to it.

    File systems without symbolic links (exFAT, many network shares) are without ``latest``.
    """
    name = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    with as_run_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        for attempt in itertools.count():
            folder = out / (f"{name}_{attempt}" if attempt else name)
            if not folder.exists():
                break
        folder.mkdir()
    link = out / ".latest"
    try:
        link.unlink(missing_ok=True)
        link.symlink_to(folder.name, target_is_directory=True)
        link.replace(out / "latest")
    except OSError as error:
        link.unlink(missing_ok=True)
        logger.warning("%s: cannot be linked to %s: %s", out / "latest", folder.name, error)
    return folder


@contextmanager
def as_run_errors(folder: Path) -> Iterator[None]:
    """Raise errors of the file system as ``RunError``, one line that names the file."""
    try:
        yield
    except OSError as error:
        path = error.filename or folder
        reason = error.strerror or str(error)
        raise RunError(f"{path}: cannot write the run: {reason}") from error


@contextmanager
def logging_to(path: Path) -> Iterator[None]:
    """Write the log to a file while the block runs: of slam_bof, warnings of all others.

    The last line says how the run ended, if by an error.
    """
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.addFilter(
        lambda record: record.levelno >= logging.WARNING or record.name.startswith("slam_bof")
    )
    root = logging.getLogger()
    packages = [logging.getLogger(name) for name in ("slam_bof", "slam_bof_plugins")]
    levels = [package.level for package in packages]
    root.addHandler(handler)
    for package in packages:
        package.setLevel(logging.INFO)
    try:
        yield
    except KeyboardInterrupt as interruption:
        _write(handler, logging.WARNING, f"interrupted: {interruption}")
        raise
    except BaseException as error:
        _write(handler, logging.ERROR, f"failed: {type(error).__name__}: {error}")
        raise
    finally:
        root.removeHandler(handler)
        for package, level in zip(packages, levels, strict=True):
            package.setLevel(level)
        handler.close()


def _write(handler: logging.Handler, level: int, message: str) -> None:
    """Write a line to one log only, because the error itself is shown to the user."""
    handler.handle(logging.LogRecord(__name__, level, __file__, 0, message, None, None))


def link_map(folder: Path, map_file: Path) -> None:
    """Create the link ``map.db`` in a run's folder to a map elsewhere, if that is possible."""
    target = os.path.relpath(os.path.realpath(map_file), os.path.realpath(folder))
    try:
        (folder / "map.db").symlink_to(target)
    except OSError as error:
        logger.warning("%s: cannot be linked to %s: %s", folder / "map.db", target, error)


def read_run(folder: Path) -> ReportData:
    """Read a finished run for its report, without the true labels, which a run does not save.

    Raises
    ------
    RunError
        If the folder is not one of a finished run.
    SlamBofError
        If one of its files is damaged.
    """
    metrics = folder / "metrics.json"
    groundtruth = folder / "trajectory_groundtruth_tum.txt"
    try:
        figures = json.loads(read_text(metrics))
    except FileNotFoundError:
        found = "no metrics.json there" if folder.is_dir() else "no such folder"
        raise RunError(f"{folder}: found {found}, expected the folder of a finished run") from None
    except (OSError, ValueError, RecursionError) as error:
        found = getattr(error, "strerror", None) or str(error)
        raise RunError(f"{metrics}: found {found}, expected the metrics of a run") from error
    if not isinstance(figures, dict):
        raise RunError(f"{metrics}: found no object, expected the metrics of a run")
    for key, value in figures.items():
        if not isinstance(value, str | int | float | None):
            raise RunError(f"{metrics}: found a list or object as {key[:80]!r}, expected a number")
    odometry = read_tum(folder / "trajectory_odometry_tum.txt")
    optimized = read_tum(folder / "trajectory_optimized_tum.txt")
    if len(odometry) != len(optimized):
        found = f"{len(odometry)} poses of odometry and {len(optimized)} optimized"
        raise RunError(f"{folder}: found {found}, expected the same frames")
    if not all(np.isfinite(trajectory.poses).all() for trajectory in (odometry, optimized)):
        raise RunError(f"{folder}: found unknown poses in its trajectories, expected all of them")
    with MapStore.open(folder / "map.db") as store, store.snapshot():
        # The run may be one of several sessions of its map.
        own = [k for k in store.keyframes() if k.session == figures.get("session", 0)]
        ids = range(own[0].id, own[-1].id + 1) if own else range(0)
        return ReportData(
            metrics=figures,
            odometry=odometry,
            optimized=optimized,
            groundtruth=read_tum(groundtruth) if groundtruth.is_file() else None,
            keyframes=[replace(keyframe, id=keyframe.id - ids.start) for keyframe in own],
            components=components_of(store)[ids.start : ids.stop].tolist(),
            loops=of_session(store.loops(), ids),
            candidates=of_session(store.candidates(), ids),
            plans=read_plans(store),
            pairs=picture_pairs(
                store, of_session(store.candidates(), ids), figures.get("session", 0)
            ),
            health=read_health(folder / "health.csv"),
            warnings=read_warnings(folder / "run.log"),
            command=rerun_command(folder, store),
            configuration=_read_if_there(folder / "config.yaml"),
        )


def rerun_command(folder: Path, store: MapStore) -> str:
    """Return the command line that repeats a run; empty if its sequence is not known."""
    source = json.loads(store.parameters().get("source") or "{}")
    if not source:
        return ""
    frames = f" --frames {source['frames']}" if source.get("frames") else ""
    limit = store.sessions()[-1].max_frames
    limited = "" if limit is None else f" --max-frames {limit}"
    path = shlex.quote(source["path"])
    return f"slam-bof run {path}{frames}{limited} --config {shlex.quote(str(folder))}/config.yaml"


def _read_if_there(path: Path) -> str:
    try:
        return read_text(path) if path.is_file() else ""
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"{path}: found {error}, expected text") from error
