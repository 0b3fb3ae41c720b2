"""What a ``map.db`` holds, read row by row; a damaged or implausible row is an error."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import MapError
from slam_bof.geometry import restore_frame
from slam_bof.scenes import MapRoom
from slam_bof.store.database import MapDatabase
from slam_bof.store.row_checks import find_fault
from slam_bof.store.row_codec import (
    decode_candidate,
    decode_constellation,
    decode_frame,
    decode_keyframe,
    decode_loop,
    decode_odometry,
    decode_pose,
    decode_room,
    decode_scene,
    decode_view,
)
from slam_bof.store.schema import KEY_COLUMNS
from slam_bof.types import (
    Array,
    Candidate,
    DepthFrame,
    EdgeKind,
    FramePose,
    Intrinsics,
    Keyframe,
    Loop,
    OdometryState,
    SavedConstellation,
    Scene,
    SubsampledDepth,
)

__all__ = ["MapReader", "Session"]


@dataclass(frozen=True, slots=True)
class Session:
    """A run that added keyframes to a map.

    ``config`` is YAML; ``max_frames`` is the limit the run was given, None for all frames.
    """

    id: int
    dataset: str
    sequence: str
    config: str = ""
    seed: int = 0
    version: str = ""
    max_frames: int | None = None
    is_finished: bool = False

    @property
    def first_frame(self) -> int:
        """The number, in the whole sequence, of the first frame of a slice ``name[A:B]``."""
        match = re.search(r"\[(\d{1,15}):\d+\]$", self.sequence)
        return int(match[1]) if match else 0


class MapReader(MapDatabase):
    """Reads the keyframes, frames, loops, candidates, rooms and parameters of a map."""

    _classes: tuple[str, ...] | None = None
    _camera: Intrinsics | None = None
    is_checked: bool = False
    """Whether all rows of the present snapshot were checked, so that readers need not do it."""

    def parameters(self) -> dict[str, str]:
        """Return the parameters of the whole map."""
        rows = self.rows("parameters", "ORDER BY key")
        return {row["key"]: row["value"] for row in rows}

    def classes(self) -> tuple[str, ...]:
        """Return the scene classes in the order of the probabilities, () without labels."""
        if not self._classes:
            self._classes = tuple(json.loads(self.parameters().get("classes", "[]")))
        return self._classes

    def intrinsics(self) -> Intrinsics | None:
        """Return the depth camera that the map was made with, for full images, if known."""
        if self._camera is None:  # once known, it stays
            camera = self.parameters().get("camera")
            self._camera = None if camera is None else Intrinsics(**json.loads(camera))
        return self._camera

    def sessions(self) -> list[Session]:
        """Return the sessions of the map, in order."""
        rows = self._counted("sessions", self.rows("sessions", "ORDER BY id"))
        values = ({field.name: row[field.name] for field in fields(Session)} for row in rows)
        return [Session(**{**v, "is_finished": bool(v["is_finished"])}) for v in values]

    def frames(self, session_id: int) -> list[FramePose]:
        """Return a session's frames up to its newest keyframe, or all if it is finished."""
        with self.snapshot():
            rows = self.rows("frames", "WHERE session = ? ORDER BY frame_index", session_id)
            ((last,),) = self.select(
                "SELECT coalesce(max(frame_index), -1) FROM keyframes WHERE session = ?", session_id
            )
        self._counted(f"frames of session {session_id}", rows, "frame_index")
        if len(rows) <= last:
            raise self._damage(f"{len(rows)} frames of session {session_id}", f"{last + 1} or more")
        return [decode_frame(row) for row in rows]

    def keyframe_rows(self) -> list[Any]:
        """Return the rows of all keyframes, in the order of their ids, which count from 0."""
        with self.snapshot():
            rows = self._counted("keyframes", self.rows("keyframes", "ORDER BY id"))
            ((n_sessions,),) = self.select("SELECT count(*) FROM sessions")
        places = [(row["session"], row["frame_index"]) for row in rows]
        if places and (places != sorted(places) or places[-1][0] >= n_sessions):
            raise self._damage(
                "keyframes in another order than their frames, or without a session",
                "sessions, and frames within each, that increase",
            )
        return rows

    def keyframes(self) -> list[Keyframe]:
        """Return all keyframes, in the order of their ids."""
        with self.snapshot():
            return [self.decode(row) for row in self.keyframe_rows()]

    def decode(self, row: Any) -> Keyframe:
        """Return the keyframe in a row of ``keyframes``."""
        self.scene(row)
        return decode_keyframe(row, self.classes())

    def scene(self, row: Any) -> Scene | None:
        """Return the label of the image alone in a row of ``keyframes``, None if it has none."""
        classes = self.classes()
        for probabilities in (row["probabilities"], row["smoothed_probabilities"]):
            if probabilities is not None and len(probabilities) != 8 * len(classes):
                raise self._damage(
                    f"{len(probabilities) // 8} probabilities of keyframe {row['id']}",
                    f"one for each class: {', '.join(classes)}",
                )
        return decode_scene(row, classes)

    def map_poses(self) -> Array:
        """Return T_map_camera of all keyframes, (K, 4, 4), NaN before their session is finished."""
        rows = self.keyframe_rows()
        poses = np.full((len(rows), 4, 4), np.nan)
        for i, row in enumerate(rows):
            if row["map_tx"] is not None:
                poses[i] = decode_pose(row, "map_")
        return poses

    def anchors(self) -> NDArray[np.int64]:
        """Return the id (K,) of each keyframe, or that of its anchor if it was culled."""
        ((n,),) = self.select("SELECT count(*) FROM keyframes")
        anchors = np.arange(n)
        for row in self.rows("culled", "WHERE keyframe_id < ?", n):  # and anchors are older
            anchors[row["keyframe_id"]] = row["anchor_id"]
        return anchors

    def rooms(self) -> list[MapRoom]:
        """Return the rooms of the map; none until a session is finished."""
        ids_by_room: dict[int, list[int]] = {}
        with self.snapshot():
            for row in self.rows("keyframes", "WHERE region IS NOT NULL ORDER BY id"):
                ids_by_room.setdefault(row["region"], []).append(row["id"])
            rows = self.rows("regions", "ORDER BY id")
        return [decode_room(row, ids_by_room.get(row["id"], ())) for row in rows]

    def view(self, keyframe_id: int) -> DepthFrame | None:
        """Return a keyframe's subsampled depth image; None in maps made before version 4."""
        rows = self.rows("views", "WHERE keyframe_id = ?", keyframe_id)
        if not rows:
            return None
        ((stamp_s,),) = self.select("SELECT stamp_s FROM keyframes WHERE id = ?", keyframe_id)
        return restore_frame(self.depth_of(rows[0]), stamp_s)

    def constellation(self, keyframe_id: int) -> SavedConstellation | None:
        """Return how a keyframe was described for the search, None if that was not saved."""
        rows = self.rows("constellations", "WHERE keyframe_id = ?", keyframe_id)
        return decode_constellation(rows[0]) if rows else None

    def odometry(self, session_id: int) -> OdometryState | None:
        """Return the newest saved state of a session's odometry, None if there is none."""
        return decode_odometry(self.rows("odometry", "WHERE session = ? ORDER BY name", session_id))

    def loops(self) -> list[Loop]:
        """Return all loops and covisibility edges of the graph, in the order they entered it."""
        return [decode_loop(row) for row in self.loop_rows()]

    def loop_rows(self, *, covisibility: bool = True) -> list[Any]:
        """Return the rows of ``candidates`` that ``loops`` decodes, maybe without covisibility."""
        tail = "WHERE decision = 'accepted' AND loop_id IS NOT NULL AND (? OR kind <> ?)"
        return self.candidate_rows(f"{tail} ORDER BY loop_id", covisibility, EdgeKind.COVISIBILITY)

    def candidates(self) -> list[Candidate]:
        """Return the audit trail, in the order it was written."""
        return [decode_candidate(row) for row in self.candidate_rows("ORDER BY id")]

    def candidate_rows(self, tail: str, *values: object) -> list[Any]:
        """Return rows of ``candidates`` as ``rows`` does, all of keyframes that the map has."""
        with self.snapshot():
            rows = self.rows("candidates", tail, *values)
            ((n,),) = self.select("SELECT count(*) FROM keyframes")
        for row in rows:
            if max(row["query_id"], row["match_id"]) >= n:
                raise self._damage(
                    f"candidate {row['id']} of keyframes {row['query_id']} and {row['match_id']}",
                    f"ids below {n}",
                )
        return rows

    def rows(self, table: str, tail: str, *values: object) -> list[Any]:
        """Return rows of a table after checking that each is whole and plausible.

        Parameters
        ----------
        table, tail, values
            The statement is ``SELECT * FROM table tail``, with these values.

        Raises
        ------
        MapError
            If a row is damaged or implausible; the first one is named.
        """
        rows = self.select(f"SELECT * FROM {table} {tail}", *values)
        for row in () if self.is_checked else rows:
            if fault := find_fault(table, row):
                raise MapError(
                    f"{self.path}: found a damaged row of {table}, {row[KEY_COLUMNS[table]]}, "
                    f"which {fault}; slam-bof map check lists all damage, slam-bof map recover "
                    "saves the rest"
                )
        return rows

    def depth_of(self, row: Any) -> SubsampledDepth:
        """Return the depth image in a row of ``views``; ``MapError`` if it is damaged."""
        camera = self.intrinsics()
        depth = None if camera is None else decode_view(row, camera)
        if depth is None:
            raise MapError(
                f"{self.path}: found a damaged depth image of keyframe {row['keyframe_id']}, "
                "expected a 16-bit PNG"
            )
        return depth

    def _counted(self, what: str, rows: list[Any], column: str = "id") -> list[Any]:
        """Return rows whose numbers count from 0; ``MapError`` if one is missing."""
        for number, row in enumerate(rows):
            if row[column] != number:
                raise self._damage(f"{what} without number {number}", "0, 1, 2 ...")
        return rows

    def _damage(self, found: str, expected: str) -> MapError:
        return MapError(
            f"{self.path}: found {found}, expected {expected}; slam-bof map recover saves the rest"
        )
