"""Maps merged to one, by what is recognised of each in the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from slam_bof.core import StageClock
from slam_bof.errors import MapError
from slam_bof.geometry import thicken
from slam_bof.scenes import label_map
from slam_bof.slam import KeyframeMap, config as configs
from slam_bof.store import MapStore, SessionResult, read_records
from slam_bof.types import LOST, FramePose, KeyframeRecord

__all__ = ["Merged", "merge_maps"]

LEFT_OUT = "contradicts the other loops, weighed all together when maps were merged"


class Merged(NamedTuple):
    """What maps were merged to; one part if all were recognised in each other."""

    n_sessions: int
    n_keyframes: int
    n_loops_across: int
    """Loops from one map to another."""
    n_parts: int


def merge_maps(paths: Sequence[Path], out: Path) -> Merged:
    """Join maps to the first of them, as sessions of one graph, in a new file.

    Their keyframes are looked for in those before as a run's are, by the first map's
    configuration; where nothing is recognised, a map stays a part of its own.

    Raises
    ------
    MapError
        If there is a file already, a run was interrupted, or cameras or models differ.
    """
    if out.exists():
        raise MapError(f"{out}: found a file, expected none where a new map is to be made")
    new = out.with_name(f".{out.name}.merged")
    new.unlink(missing_ok=True)
    try:
        with MapStore.open(paths[0]) as first:
            first.copy_to(new)
        with MapStore.open(new, read_only=False) as target:
            merged = _join(target, paths)
        new.rename(out)
    finally:
        new.unlink(missing_ok=True)
    return merged


def _join(target: MapStore, paths: Sequence[Path]) -> Merged:
    """Take the other maps' keyframes as sessions of the first, and finish them."""
    sessions = target.sessions()
    _check_finished(target, paths[0])
    config = configs.parse(sessions[-1].config, f"{paths[0]}: session {sessions[-1].id}")
    keyframes = KeyframeMap.from_config(config, StageClock())
    for record in read_records(target):
        while keyframes.session < record.keyframe.session:
            keyframes.begin_session()
        keyframes.take_back(record)
    starts: list[int] = []
    tails: dict[int, list[FramePose]] = {}
    for path in paths[1:]:
        starts.append(len(keyframes))
        with MapStore.open(path) as other:
            _check_finished(other, path)
            _check_alike(target, other, paths[0])
            for session in other.sessions():
                keyframes.begin_session()
                id_ = keyframes.session
                target.begin_session(replace(session, id=id_, is_finished=False))
                tails[id_] = _take(keyframes, target, other, session.id)
    keyframes.graph.optimize()
    T_map_camera, graph = keyframes.graph.poses(), keyframes.graph
    labels = label_map(
        keyframes.keyframes, T_map_camera, config.labels, config.regions, parts=keyframes.parts
    )
    for id_, frames in tails.items():
        result = SessionResult(frames, T_map_camera, *labels, graph.left_out, LEFT_OUT)
        target.finish(id_, result)
    across = sum(
        any(loop.match_id < start <= loop.query_id for start in starts) for loop in graph.loops
    )
    return Merged(keyframes.session + 1, len(keyframes), across, len(graph.parts))


def _take(
    keyframes: KeyframeMap, target: MapStore, other: MapStore, session_id: int
) -> list[FramePose]:
    """Take a session's keyframes as a new one's; return the frames after the last of them."""
    n_segments = keyframes.keyframes[-1].segment + 1 if len(keyframes) else 0
    frames = other.frames(session_id)
    later = n_segments - min((f.segment for f in frames if f.segment != LOST), default=0)
    frames = [f if f.segment == LOST else replace(f, segment=f.segment + later) for f in frames]
    start = 0
    for record in read_records(other):
        old = record.keyframe
        if old.session != session_id:
            continue
        keyframe = replace(
            old, id=len(keyframes), session=keyframes.session, segment=old.segment + later
        )
        verified = keyframes.add_described(keyframe, thicken(record.thin, keyframe.stamp_s))
        own = tuple(frames[start : keyframe.frame_index + 1])
        start = keyframe.frame_index + 1
        outcome = (
            tuple(verified.candidates),
            tuple(verified.measured),
            tuple(verified.admitted),
        )
        target.write(KeyframeRecord(keyframe, record.thin, own, *outcome, {}))
    return frames[start:]


def _check_finished(store: MapStore, path: Path) -> None:
    sessions = store.sessions()
    if not sessions:
        raise MapError(f"{path}: found an empty map, expected one with keyframes")
    if not all(session.is_finished for session in sessions):
        raise MapError(f"{path}: found an interrupted run, expected a finished one: resume it")


def _check_alike(target: MapStore, other: MapStore, first: Path) -> None:
    ours, theirs = target.parameters(), other.parameters()
    for key in ("camera", "model", "classes"):
        if ours.get(key) != theirs.get(key):
            raise MapError(
                f"{other.path}: found {key} {str(theirs.get(key))[:90]}, expected that of "
                f"{first}: {str(ours.get(key))[:90]}"
            )
