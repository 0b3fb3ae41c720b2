"""Merging of maps: loops between their keyframes join them in one pose graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from slam_bof.core import StageClock
from slam_bof.errors import MapError
from slam_bof.geometry import restore_frame
from slam_bof.scenes import label_map
from slam_bof.slam import Config, KeyframeMap, config as configs
from slam_bof.store import MapStore, SessionResult, replay_keyframes, require_intact
from slam_bof.types import LOST, FramePose, KeyframeRecord

__all__ = ["MergeResult", "merge_maps"]

LEFT_OUT_REASON = "inconsistent with the other loops in the optimisation of the merged maps"


class MergeResult(NamedTuple):
    """Size of a merged map; it has one component if loops connect all the maps."""

    n_sessions: int
    n_keyframes: int
    n_loops_across: int
    """Loops between keyframes of different maps."""
    n_components: int


def merge_maps(paths: Sequence[Path], out: Path) -> MergeResult:
    """Merge maps into a new file, as sessions of one pose graph.

    The keyframes of each map are matched against those of the maps before it, as in a run with
    the configuration of the first map. A map without accepted loops to the others stays a
    component of its own.

    Raises
    ------
    MapError
        If the new file exists, a map is damaged or given twice, a run was interrupted, or the maps'
        cameras or models differ.
    """
    if out.exists():
        raise MapError(f"{out}: found a file, expected none: a new map needs a new name")
    for k, path in enumerate(paths):
        require_intact(path)
        if any(path.samefile(other) for other in paths[:k]):
            raise MapError(f"{path}: found it twice, expected different maps to merge")
    new = out.with_name(f".{out.name}.merged")
    new.unlink(missing_ok=True)
    try:
        with MapStore.open(paths[0]) as first:
            first.copy_to(new)
        with MapStore.open(new, read_only=False) as target:
            merged = _merge_into_first(target, paths)
        new.rename(out)
    finally:
        new.unlink(missing_ok=True)
    return merged


def _merge_into_first(target: MapStore, paths: Sequence[Path]) -> MergeResult:
    """Add the sessions of the other maps to a copy of the first, and finish them."""
    sessions = target.sessions()
    _check_finished(target, paths[0])
    config = configs.parse_saved(sessions[-1].config, f"{paths[0]}: session {sessions[-1].id}")
    keyframes = _replay(target, config)
    starts: list[int] = []
    tails: dict[int, list[FramePose]] = {}
    for path in paths[1:]:
        starts.append(len(keyframes))
        with MapStore.open(path) as other:
            _check_finished(other, path)
            _check_compatible(target, other, paths[0])
            for session in other.sessions():
                keyframes.begin_session()
                id_ = keyframes.session
                target.begin_session(replace(session, id=id_, is_finished=False))
                tails[id_] = _add_session(keyframes, target, other, session.id)
    _finish(target, keyframes, config, tails)
    loops = keyframes.loops
    across = sum(any(loop.match_id < start <= loop.query_id for start in starts) for loop in loops)
    return MergeResult(
        n_sessions=keyframes.session + 1,
        n_keyframes=len(keyframes),
        n_loops_across=across,
        n_components=keyframes.n_components,
    )


def _replay(store: MapStore, config: Config) -> KeyframeMap:
    """Return the keyframes of a saved map, to continue it."""
    keyframes = KeyframeMap(config, StageClock())
    for record in replay_keyframes(store):
        while keyframes.session < record.keyframe.session:
            keyframes.begin_session()
        keyframes.replay(record)
    return keyframes


def _finish(
    target: MapStore,
    keyframes: KeyframeMap,
    config: Config,
    tails: Mapping[int, list[FramePose]],
) -> None:
    """Optimise and label the whole map, and finish the sessions that were added to it.

    ``tails`` are the frames after the last keyframe of each of these.
    """
    keyframes.graph.optimize()
    T_map_camera = keyframes.poses()
    smoothed, rooms = label_map(
        keyframes.keyframes,
        T_map_camera,
        config.labels,
        config.rooms,
        components=keyframes.components,
        anchors=keyframes.anchors,
    )
    for id_, frames in tails.items():
        result = SessionResult(
            frames=frames,
            T_map_camera=T_map_camera,
            smoothed=smoothed,
            rooms=rooms,
            left_out=keyframes.loops_left_out,
            reason=LEFT_OUT_REASON,
        )
        target.finish(id_, result)


def _add_session(
    keyframes: KeyframeMap, target: MapStore, other: MapStore, session_id: int
) -> list[FramePose]:
    """Add a session of another map; return the frames after its last keyframe."""
    n_segments = keyframes.keyframes[-1].segment + 1 if len(keyframes) else 0
    frames = other.frames(session_id)
    later = n_segments - min((f.segment for f in frames if f.segment != LOST), default=0)
    frames = [f if f.segment == LOST else replace(f, segment=f.segment + later) for f in frames]
    start = 0
    for record in replay_keyframes(other):
        old = record.keyframe
        if old.session != session_id:
            continue
        keyframe = replace(
            old, id=len(keyframes), session=keyframes.session, segment=old.segment + later
        )
        verified = keyframes.add(keyframe, restore_frame(record.depth, keyframe.stamp_s))
        culled = keyframes.cull()
        own = tuple(frames[start : keyframe.frame_index + 1])
        start = keyframe.frame_index + 1
        target.write(
            KeyframeRecord(
                keyframe=keyframe,
                depth=record.depth,
                frames=own,
                candidates=tuple(verified.candidates),
                measured=tuple(verified.measured),
                admitted=tuple(verified.admitted),
                culled=culled,
                state={},
                constellation=keyframes.newest_constellation,
            )
        )
    return frames[start:]


def _check_finished(store: MapStore, path: Path) -> None:
    sessions = store.sessions()
    if not sessions:
        raise MapError(f"{path}: found an empty map, expected one with keyframes")
    if not all(session.is_finished for session in sessions):
        raise MapError(
            f"{path}: found an interrupted run, expected a finished one: resume it, or "
            f"slam-bof map finish {path}"
        )


def _check_compatible(target: MapStore, other: MapStore, first: Path) -> None:
    ours, theirs = target.parameters(), other.parameters()
    for key in ("camera", "model", "classes"):
        if ours.get(key) != theirs.get(key):
            raise MapError(
                f"{other.path}: found {key} {str(theirs.get(key))[:90]}, expected that of "
                f"{first}: {str(ours.get(key))[:90]}"
            )
