"""Maps: damaged ones, and those of others, who sign what they change."""

from __future__ import annotations

import dataclasses
import json
import random
import shutil
import sqlite3
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from fuzzing.cases import Reader, expect, expect_numbers, quiet, turn
from fuzzing.mutations import mutate_bytes, mutate_json, mutate_text, strange_value
from slam_bof.maps import MapLocalizer, MapSession, export_map, finish_map
from slam_bof.slam import config as configs
from slam_bof.store import (
    KEY_COLUMNS,
    MapStore,
    check_map,
    prune_map,
    query_keyframes,
    query_loops,
    query_rooms,
    recover_map,
)
from slam_bof.store.sqlite import prepare, update_checksums

__all__ = ["CONFIG", "READERS", "forge_map"]

CONFIG = configs.override(
    configs.preset("indoor"),
    [
        "keyframes.policy=every",
        "keyframes.every=6",
        "model=synthetic",
        "verification.consistency.n_required=0",
    ],
)


def prepare_map(place: Path) -> None:
    """Make a map of a slow turn in a room, with loops, labels and rooms."""
    frames, poses = turn()
    with MapSession.open(place / "map.db", config=CONFIG, sequence="turn") as session:
        for k, (frame, T) in enumerate(zip(frames, poses, strict=True)):
            session.closer.process(dataclasses.replace(frame, stamp_s=k / 30), T)
    (place / "answer.json").write_text(json.dumps(answer(place / "map.db")))


def answer(path: Path) -> Any:
    """Return what queries say of a map."""
    with MapStore.open(path) as store:
        found = [query_keyframes(store), query_loops(store, considered=True), query_rooms(store)]
        camera = store.intrinsics()
        plain = [[dataclasses.asdict(item) for item in items] for items in found]
        poses = [
            frame.T_odom_camera.tolist() for s in store.sessions() for frame in store.frames(s.id)
        ]
        return json.loads(
            json.dumps([plain, poses, dataclasses.asdict(camera) if camera else None])
        )


def damage_map(place: Path, case: Path, rng: random.Random) -> None:
    """Change bytes of a map."""
    (case / "map.db").write_bytes(mutate_bytes((place / "map.db").read_bytes(), rng))


def read_damaged_map(place: Path, case: Path) -> None:
    """Check, recover, prune and read a map; what is read must be what was written."""
    path, pruned = case / "map.db", case / "pruned.db"
    written = json.loads((place / "answer.json").read_text())
    quiet(lambda: check_map(path))
    recovered = quiet(lambda: recover_map(path, case / "recovered.db"))
    if recovered and not recovered.is_camera_lost:
        expect(check_map(case / "recovered.db") == [], "recovered a damaged map")
    shutil.copy(path, pruned)
    if quiet(lambda: prune_map(pruned, lambda store: [1])):  # which signs all rows again
        expect(quiet(lambda: answer(path)) == written, "pruned a damaged map")
        expect(check_map(pruned) == [], "pruned to a damaged map")
    expect(answer(path) == written, "another answer")


def forge_map(place: Path, case: Path, rng: random.Random) -> None:
    """Change a value of a map, or its blobs, and sign it as slam_bof does."""
    shutil.copy(place / "map.db", case / "map.db")
    with closing(sqlite3.connect(case / "map.db")) as db:
        prepare(db)
        db.execute("PRAGMA ignore_check_constraints = ON")
        for _ in range(rng.choice((1, 1, 1, 2))):
            table = rng.choice((*KEY_COLUMNS, "parameters", "keyframes", "sessions"))
            rows = db.execute(f"SELECT rowid AS place, * FROM {table}").fetchall()
            if not rows:
                continue
            row = rng.choice(rows)
            name = rng.choice(row.keys()[1:-1])
            old = row[name]
            value = forged(old, rng)
            where = "WHERE rowid = ?" if rng.random() < 0.8 else "WHERE ? IS NOT NULL"
            try:
                db.execute(f"UPDATE {table} SET {name} = ? {where}", (value, row["place"]))
            except sqlite3.IntegrityError:
                db.execute(f"DELETE FROM {table} WHERE rowid = ?", (row["place"],))
        if rng.random() < 0.05:
            db.execute("CREATE TRIGGER t AFTER UPDATE ON keyframes BEGIN SELECT 1; END")
        for table in KEY_COLUMNS:
            update_checksums(db, table)
        db.commit()


def forged(old: Any, rng: random.Random) -> Any:
    """Return another value for one in a map."""
    if isinstance(old, bytes) and rng.random() < 0.8:
        return mutate_bytes(old, rng)
    if isinstance(old, str) and old[:1] in ("{", "[") and rng.random() < 0.8:
        with suppress(ValueError):  # it was changed before
            return json.dumps(mutate_json(json.loads(old), rng))
    if isinstance(old, str) and rng.random() < 0.6:
        return mutate_text(old, rng).encode(errors="replace").decode()
    if isinstance(old, float) and rng.random() < 0.5:
        return old * rng.choice((-1.0, 1e3, 1e30, float("inf"), 0.0))
    value = strange_value(rng)
    return json.dumps(value) if isinstance(value, dict | list) else value


def read_forged_map(place: Path, case: Path) -> None:
    """Read, localise in, continue, export and recover a map; what is read must be plausible."""
    path = case / "map.db"
    quiet(lambda: check_map(path))
    quiet(lambda: recover_map(path, case / "recovered.db"))
    quiet(lambda: continue_map(path, case / "continued.db"))
    expect_numbers(answer(path), "answer")
    with MapStore.open(path) as store:
        for kind in ("tum", "csv", "g2o", "ply", "occupancy"):
            quiet(lambda kind=kind: export_map(store, case / f"x.{kind}", kind))
    localizer = MapLocalizer.open(path)
    found = localizer.localize(turn()[0][0])
    if found.localization.is_known:  # else overlap and error are NaN: not measured
        expect_numbers(found, "localization")


def continue_map(path: Path, copy: Path) -> None:
    """Finish the last session of a copy again, as of an interrupted run."""
    shutil.copy(path, copy)
    with closing(sqlite3.connect(copy)) as db:
        prepare(db)
        db.execute("UPDATE sessions SET is_finished = 0")
        update_checksums(db, "sessions")
        db.commit()
    with MapStore.open(copy, read_only=False) as store:
        finish_map(store)


READERS = {
    "map": Reader(6, prepare_map, damage_map, read_damaged_map),
    "map-signed": Reader(0.8, prepare_map, forge_map, read_forged_map),
}
