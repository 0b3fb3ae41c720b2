"""The readers that ``scripts/fuzz`` tries: files to mutate, and checks of what was read."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import random
import shutil
import socket
import sqlite3
import struct
import tarfile
import threading
import zipfile
import zlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from _mutations import mutate_array, mutate_bytes, mutate_json, mutate_text, strange_value

from slam_bof.bof import LayerParams, PlaceParams
from slam_bof.core import registry
from slam_bof.datasets import read_depth_image
from slam_bof.datasets.download_archive import unpack
from slam_bof.datasets.download_http import fetch
from slam_bof.geometry import read_kitti, read_tum, se3
from slam_bof.maps import MapLocalizer, MapSession, export_map, finish_map
from slam_bof.scenes import FrameDescriptors, SceneClassifier, fit_model, model as models
from slam_bof.scenes.stored_classifier import read_entries, zip_entries
from slam_bof.slam import config as configs
from slam_bof.store import (
    KEY_COLUMNS,
    MapStore,
    check_map,
    query_keyframes,
    query_loops,
    query_rooms,
    recover_map,
)
from slam_bof.store.sqlite import prepare, update_checksums
from slam_bof.testing import example_frames
from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["READERS", "Reader", "turn"]

MAX_DEPTH_M = 1000.0
registry._found = cache(registry._found)  # each look at what is installed takes 0.1 s
CLASSIFIERS = ("svm-linear", "svm-rbf", "random-forest", "knn", "mlp", "naive-bayes")


@dataclass(frozen=True)
class Reader:
    """What to prepare in a folder, how to make a case of it in another, and how to read that."""

    weight: float
    prepare: Callable[[Path], None]
    mutate: Callable[[Path, Path, random.Random], None]
    read: Callable[[Path, Path], None]


@cache
def turn() -> tuple[list[DepthFrame], Any]:
    """Return a few small frames, rendered once."""
    frames, poses = example_frames(24)
    return [shrink(frame) for frame in frames], poses


def shrink(frame: DepthFrame) -> DepthFrame:
    """Return a frame of a quarter of the size."""
    camera, depth = frame.intrinsics, frame.depth[::4, ::4].copy()
    small = Intrinsics(depth.shape[1], depth.shape[0], *(
        value / 4 for value in (camera.fx, camera.fy, camera.cx, camera.cy)
    ))  # fmt: skip
    return DepthFrame(frame.stamp_s, depth, small)


def expect(holds: bool, what: str) -> None:
    """Raise ``AssertionError`` unless a value is plausible."""
    if not holds:
        raise AssertionError(what)


def expect_numbers(value: Any, what: str) -> None:
    """Check that all numbers in a value are finite and moderate."""
    if isinstance(value, dict):
        for key, item in value.items():
            expect_numbers(item, f"{what}.{key}")
    elif isinstance(value, list | tuple):
        for item in value:
            expect_numbers(item, what)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            expect_numbers(getattr(value, field.name), f"{what}.{field.name}")
    elif isinstance(value, float):
        expect(math.isfinite(value) and abs(value) < 1e19, f"{what} is {value}")
    elif isinstance(value, np.ndarray) and value.dtype.kind == "f":
        expect(bool(np.isfinite(value).all()), f"{what} is not finite")


def expect_frame(frame: DepthFrame) -> None:
    """Check that a frame is one: its depth is within 1 km."""
    depth_m = frame.depth_m()
    expect(bool(np.isfinite(depth_m).all() and depth_m.max() <= MAX_DEPTH_M), "depth")
    expect(math.isfinite(frame.stamp_s), "stamp_s")


# Maps


def prepare_map(place: Path) -> None:
    """Make a map of a slow turn in a room, with loops, labels and rooms."""
    frames, poses = turn()
    config = configs.override(
        configs.preset("indoor"), ["keyframes.policy=every", "model=synthetic"]
    )
    config = configs.override(
        config, ["keyframes.every=6", "verification.consistency.n_required=0"]
    )
    with MapSession.open(place / "map.db", config=config, sequence="turn") as session:
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
    """Check, recover and read a map; what is read must be what was written."""
    path = case / "map.db"
    quiet(lambda: check_map(path))
    recovered = quiet(lambda: recover_map(path, case / "recovered.db"))
    if recovered and not recovered.is_camera_lost:
        expect(check_map(case / "recovered.db") == [], "recovered a damaged map")
    expect(answer(path) == json.loads((place / "answer.json").read_text()), "another answer")


def quiet(attempt: Callable[[], Any]) -> Any:
    """Return the result, None after an error in one line."""
    from slam_bof.errors import SlamBofError

    try:
        return attempt()
    except SlamBofError:
        return None


def forge_map(place: Path, case: Path, rng: random.Random) -> None:
    """Change a value of a map, or its blobs, and sign it as slam_bof does."""
    shutil.copy(place / "map.db", case / "map.db")
    with closing(sqlite3.connect(case / "map.db")) as db:
        prepare(db)
        db.execute("PRAGMA ignore_check_constraints = ON")
        for _ in range(rng.choice((1, 1, 1, 2))):
            table = rng.choice((*KEY_COLUMNS, "parameters", "keyframes", "sessions"))
            rows = db.execute(f"SELECT rowid AS place, * FROM {table}").fetchall()
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
    if isinstance(old, str) and old[:1] in "{[" and rng.random() < 0.8:
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
    expect_numbers(localizer.localize(turn()[0][0]), "localization")


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


# Models


def prepare_models(place: Path) -> None:
    """Train a model for each kind of classifier on random shapes."""
    rng = np.random.default_rng(0)
    n_frames, each, kinds = 60, 6, np.arange(60) % 3
    values = rng.random((n_frames, each, 180)) * 0.3
    values[np.arange(n_frames), :, kinds * 60] += 1.0
    described = FrameDescriptors(
        values.reshape(-1, 180).astype(np.float32),
        np.full(n_frames, each),
        tuple("abc"[k] for k in kinds),
        tuple(f"seq-{i // 6}" for i in range(n_frames)),
        (),
    )
    for name in CLASSIFIERS:
        made = fit_model(
            described,
            PlaceParams(layers=LayerParams(n_layers=3)),
            n_words=12,
            trained_on="random shapes",
            bag_classifier=SceneClassifier(classifier=name, n_folds=2),
        )
        models.save(made, place / f"{name}.bof")
    data = Path(models.__file__).parents[1] / "data" / "synthetic.bof"
    shutil.copy(data, place / "synthetic.bof")
    write_image(place / "frame.png", turn()[0][0])


def damage_model(place: Path, case: Path, rng: random.Random) -> None:
    """Change bytes of a model file."""
    chosen = rng.choice(sorted(place.glob("*.bof")))
    (case / "m.bof").write_bytes(mutate_bytes(chosen.read_bytes(), rng))


def forge_model(place: Path, case: Path, rng: random.Random) -> None:
    """Change an entry of a model file, or one within its classifier, under a right hash."""
    entries = read_entries(rng.choice(sorted(place.glob("*.bof"))).read_bytes())
    manifest = json.loads(entries.pop("manifest.json"))
    name = rng.choice((*sorted(entries), "manifest.json", "scenes.skops", "scenes.skops"))
    if name == "manifest.json":
        manifest = mutate_json(manifest, rng)
    elif name == "scenes.skops" and rng.random() < 0.85:
        files = read_entries(entries[name])
        inner = rng.choice((*sorted(files), *["schema.json"] * (len(files) // 2)))
        if inner == "schema.json":
            schema = mutate_json(json.loads(files[inner]), rng)
            files[inner] = json.dumps(schema).encode()
        else:
            files[inner] = mutate_array(files[inner], rng)
        entries[name] = zip_entries(files, zipfile.ZIP_STORED)
    else:
        entries[name] = mutate_array(entries[name], rng)
    if isinstance(manifest, dict):
        content = {k: v for k, v in manifest.items() if k not in ("content_sha256", "made_with")}
        manifest["content_sha256"] = models._hash(content, entries)
    entries = {"manifest.json": json.dumps(manifest).encode(), **entries}
    (case / "m.bof").write_bytes(zip_entries(entries, zipfile.ZIP_DEFLATED))


def read_model(place: Path, case: Path) -> None:
    """Load a model; its labels must be probabilities."""
    model = models.load(case / "m.bof")
    frame, _ = read_depth_image(place / "frame.png", intrinsics=(140.0, 140.0, 79.5, 59.5))
    with np.errstate(all="ignore"):
        bag = model.describer().describe(frame) if model.places.layers.axis != "gravity" else None
        labeller = model.labeller()
        if labeller is None or bag is None:
            return
        scene = labeller.label(frame, bag=bag)
    expect(bool(np.isfinite(bag.weights).all()), "weights of a bag")
    probabilities = scene.probabilities
    expect(bool(np.isfinite(probabilities).all() and probabilities.min() >= 0), "probabilities")
    expect(abs(float(probabilities.sum()) - 1.0) < 1e-3, "sum of probabilities")
    expect(scene.label in scene.classes, "label")


# Configurations


def prepare_config(place: Path) -> None:
    """Write all parameters."""
    text = configs.dump(configs.complete(configs.preset("indoor")))
    (place / "config.yaml").write_text(text)


def mutate_config(place: Path, case: Path, rng: random.Random) -> None:
    """Change the text of a configuration."""
    text = (place / "config.yaml").read_text()
    if rng.random() < 0.1:
        anchors = "".join(f"x{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
        text = f"x0: &a0 [x]\n{anchors}" + text
    for _ in range(rng.choice((1, 1, 2))):
        text = mutate_text(text, rng)
    (case / "config.yaml").write_bytes(text.encode(errors="surrogateescape"))


def read_config(place: Path, case: Path) -> None:
    """Read a configuration in each way."""
    from slam_bof.errors import ConfigError

    path = case / "config.yaml"
    text = path.read_bytes().decode(errors="replace")
    quiet(lambda: configs.parse_saved(text, "map.db"))
    quiet(
        lambda: configs.override(
            configs.Config(), [line.replace(": ", "=") for line in text.splitlines()[:9]]
        )
    )
    config = configs.complete(configs.load(path))
    expect_numbers(config.model_dump(), "config")
    expect(isinstance(ConfigError, type), "")


# Archives and servers


def mutate_archive(place: Path, case: Path, rng: random.Random) -> None:
    """Make an archive with others in it, and lie in it."""
    inner = zipped({f"seq/{k}.txt": rng.randbytes(40) for k in range(3)}, rng)
    if rng.random() < 0.15:
        inner = bomb()
    n_inner = 30 if rng.random() < 0.1 else 2
    files = {f"chess/{k}.zip": inner for k in range(n_inner)} | {"chess/a.txt": b"a" * 900}
    if rng.random() < 0.5:
        data, name = zipped(files, rng), "a.zip"
    else:
        data, name = tarred(files, rng), "a.tgz"
    (case / name).write_bytes(mutate_bytes(data, rng) if rng.random() < 0.9 else data)


def zipped(files: dict[str, bytes], rng: random.Random) -> bytes:
    """Return a zip in some compression."""
    file = io.BytesIO()
    kind = rng.choice((zipfile.ZIP_DEFLATED,) * 8 + (zipfile.ZIP_STORED, zipfile.ZIP_LZMA))
    with zipfile.ZipFile(file, "w", kind) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return file.getvalue()


@cache
def bomb() -> bytes:
    """Return an archive of 20 kB that becomes 18 MB."""
    return zipped({str(k): bytes(9_000_000) for k in range(2)}, random.Random(0))


def tarred(files: dict[str, bytes], rng: random.Random) -> bytes:
    """Return a gzipped tar, whose bytes are changed before they are packed."""
    file = io.BytesIO()
    form = rng.choice((tarfile.PAX_FORMAT, tarfile.GNU_FORMAT, tarfile.USTAR_FORMAT))
    with tarfile.open(fileobj=file, mode="w", format=form) as archive:
        for name, data in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            if form == tarfile.PAX_FORMAT and rng.random() < 0.3:
                entry.pax_headers = {"comment": "x" * 3000}
            archive.addfile(entry, io.BytesIO(data))
    data = bytearray(file.getvalue())
    for _ in range(rng.randrange(3)):
        start = 512 * rng.randrange(len(data) // 512)
        at = start + rng.choice((0, 100, 124, 124, 124, 156, 257))
        value = rng.choice(
            (
                b"\xff" * 12,
                b"\x80" + bytes(7) + b"\x01\0\0\0",
                b"77777777777\0",
                b"L",
                b"x",
                b"g",
                b"5",
            )
        )
        data[at : at + len(value)] = value
        head = data[start : start + 512]
        head[148:156] = b" " * 8
        data[start + 148 : start + 156] = b"%06o\0 " % sum(head)
    compressor = zlib.compressobj(1, wbits=31)
    return compressor.compress(bytes(data)) + compressor.flush()


def read_archive(place: Path, case: Path) -> None:
    """Unpack an archive; it may not become a hundred times its size, nor leave its folder."""
    (archive,) = case.iterdir()
    out = case / "in" / "out"
    try:
        unpack(archive, out)
    finally:
        size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
        expect(size <= max(100 * archive.stat().st_size, 10_000_000), f"{size} bytes came out")
        outside = [path.name for path in (case / "in").iterdir() if path != out]
        expect(not outside, f"{outside} outside")


ANSWER = (
    b"HTTP/1.1 200 OK\r\nContent-Length: 64\r\nETag: \"v1\"\r\nContent-Range: bytes 0-63/64\r\n"
    b"Location: http://127.0.0.1:9/x\r\nTransfer-Encoding: identity\r\n\r\n" + bytes(range(64))
)  # fmt: skip


def mutate_answer(place: Path, case: Path, rng: random.Random) -> None:
    """Change what a server answers."""
    data = ANSWER.replace(
        b"200", str(rng.choice((200, 200, 206, 302, 404, 503, 416, 100))).encode()
    )
    data = data.replace(b"identity", rng.choice((b"identity", b"chunked", b"gzip")))
    head, _, body = data.partition(b"\r\n\r\n")
    for _ in range(rng.choice((1, 2))):
        if rng.random() < 0.6:
            head = mutate_text(head.decode("latin-1"), rng).encode("utf-8", "replace")
        else:
            head = mutate_bytes(head, rng)
    (case / "answer").write_bytes(head + b"\r\n\r\n" + body)
    if rng.random() < 0.3:
        (case / "a.part").write_bytes(bytes(range(10)))
        (case / "a.part.json").write_text(
            mutate_text('{"version": "\\"v1\\""}', rng), errors="replace"
        )


def read_answer(place: Path, case: Path) -> None:
    """Fetch a file from a server that sends these bytes to every request."""
    from slam_bof.datasets import download_http
    from slam_bof.errors import DatasetError

    download_http.N_ATTEMPTS, download_http.TIMEOUT_S = 2, 1.0
    data = (case / "answer").read_bytes()
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        threading.Thread(target=serve, args=(server, data), daemon=True).start()
        try:
            fetch(f"http://127.0.0.1:{server.getsockname()[1]}/a", case / "a", wait_s=0.0)
        except DatasetError as error:
            expect(str(error).isprintable(), "what a server says is not printable")
            raise
        finally:
            server.shutdown(socket.SHUT_RDWR)


def serve(server: socket.socket, data: bytes) -> None:
    """Send the same bytes to everybody."""
    while True:
        try:
            connection, _ = server.accept()
            with closing(connection):
                connection.recv(65536)
                connection.sendall(data)
        except OSError:
            if server.fileno() < 0 or server._closed:  # type: ignore[attr-defined]
                return


# Data sets


def write_image(path: Path, frame: DepthFrame) -> None:
    """Write a depth image in millimetres."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.rint(1000 * frame.depth_m()).astype(np.uint16))


def prepare_sequences(place: Path) -> None:
    """Write four frames in every layout."""
    frames, poses = (items[:4] for items in turn())
    camera = frames[0].intrinsics
    tum = "".join(
        " ".join(map(repr, [k / 30, *T[:3, 3].tolist(), *se3.to_quaternion(T).tolist()])) + "\n"
        for k, T in enumerate(poses)
    )
    folder = place / "folder"
    for k, frame in enumerate(frames):
        write_image(folder / "depth" / f"{k / 30:.6f}.png", frame)
    (folder / "intrinsics.json").write_text(json.dumps(dataclasses.asdict(camera)))
    (folder / "groundtruth.txt").write_text(tum)
    (folder / "timestamps.txt").write_text("".join(f"{k / 30}\n" for k in range(4)))
    arrays = place / "arrays"
    (arrays / "depth").mkdir(parents=True)
    shutil.copy(folder / "intrinsics.json", arrays)
    for k, frame in enumerate(frames):
        kind = np.float32 if k % 2 else np.float64
        np.save(arrays / "depth" / f"{k}.npy", frame.depth_m().astype(kind))
    scenes = place / "7scenes" / "kitchen" / "seq-01"
    for k, (frame, T) in enumerate(zip(frames, poses, strict=True)):
        write_image(scenes / f"frame-{k:06d}.depth.png", frame)
        np.savetxt(scenes / f"frame-{k:06d}.pose.txt", T)
    replica = place / "replica"
    for k, frame in enumerate(frames):
        write_image(replica / "results" / f"depth{k:06d}.png", frame)
    (replica / "traj.txt").write_text("".join(" ".join(map(str, T.ravel())) + "\n" for T in poses))
    names = {"w": camera.width, "h": camera.height, "fx": camera.fx, "fy": camera.fy}
    names |= {"cx": camera.cx, "cy": camera.cy, "scale": 1000.0}
    (replica / "cam_params.json").write_text(json.dumps({"camera": names}))
    rgbd = place / "rgbd_dataset_freiburg3_x"
    lines = []
    for k, frame in enumerate(frames):
        write_image(rgbd / "depth" / f"{k / 30:.6f}.png", frame)
        lines.append(f"{k / 30:.6f} depth/{k / 30:.6f}.png\n")
    (rgbd / "depth.txt").write_text("".join(lines))
    (rgbd / "groundtruth.txt").write_text(tum)
    scannet = place / "scannet"
    scannet.mkdir()
    (scannet / "a.sens").write_bytes(sens(frames, list(poses)))


def sens(frames: list[DepthFrame], poses: list[Any]) -> bytes:
    """Return a ScanNet file."""
    camera = frames[0].intrinsics
    K, eye = np.eye(4, dtype="<f4"), np.eye(4, dtype="<f4").tobytes()
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    size = (camera.width, camera.height)
    parts = [struct.pack("<IQ", 4, 4), b"Toys", K.tobytes(), eye, K.tobytes(), eye]
    parts.append(struct.pack("<2i4IfQ", 2, 1, *size, *size, 1000.0, len(frames)))
    for k, (frame, T) in enumerate(zip(frames, poses, strict=True)):
        depth = zlib.compress(np.rint(1000 * frame.depth_m()).astype("<u2").tobytes(), 1)
        parts += [
            T.astype("<f4").tobytes(),
            struct.pack("<4Q", 0, 1 + 33_333 * k, 0, len(depth)),
            depth,
        ]
    return b"".join(parts)


def mutate_sequence(place: Path, case: Path, rng: random.Random) -> None:
    """Change one file of a sequence."""
    chosen = rng.choice(sorted(path for path in place.iterdir() if path.name != "case"))
    shutil.copytree(chosen, case / chosen.name)
    files = sorted(path for path in (case / chosen.name).rglob("*") if path.is_file())
    texts = [path for path in files if path.suffix in (".txt", ".json", ".sens", ".npy")]
    file = rng.choice(texts if texts and rng.random() < 0.75 else files)
    if file.suffix in (".txt", ".json"):
        text = mutate_text(file.read_text(), rng)
        file.write_bytes(text.encode(errors="surrogateescape"))
    elif file.suffix == ".npy":
        file.write_bytes(mutate_array(file.read_bytes(), rng))
    else:
        file.write_bytes(mutate_bytes(file.read_bytes(), rng))


def read_sequence(place: Path, case: Path) -> None:
    """Open a sequence and read all of it."""
    (folder,) = case.iterdir()
    for file in folder.glob("*.txt"):
        for read in (read_tum, read_kitti):
            trajectory = quiet(lambda read=read, file=file: read(file))
            if trajectory is not None and len(trajectory):
                known = np.isfinite(trajectory.poses).all(axis=(1, 2))
                expect(bool((np.abs(trajectory.poses[known]) < 1e9).all()), "a pose far away")
    if next(folder.rglob("frame-*.depth.png"), None):
        folder = folder / "kitchen" / "seq-01" if (folder / "kitchen").is_dir() else folder
    dataset = registry.open_dataset(folder)
    groundtruth = dataset.groundtruth()
    if groundtruth is not None:
        for T in groundtruth.poses[np.isfinite(groundtruth.poses).all(axis=(1, 2))]:
            expect(float(np.abs(T[:3, 3]).max()) < 1e9, "a pose far away")
    for index in range(len(dataset)):
        frame = quiet(lambda index=index: dataset.frame(index))
        if frame is not None:
            expect_frame(frame)


def prepare_images(place: Path) -> None:
    """Write one image in every format, with its camera."""
    frame = turn()[0][0]
    mm = np.rint(1000 * frame.depth_m()).astype(np.uint16)
    for suffix in ("png", "tiff"):
        cv2.imwrite(str(place / f"a.{suffix}"), mm)
    cv2.imwrite(str(place / "a.jpg"), (mm // 40).astype(np.uint8))
    np.save(place / "a.npy", frame.depth_m())
    camera = {**dataclasses.asdict(frame.intrinsics), "depth_scale": 1000.0, "depth_offset": 1.0}
    (place / "intrinsics.json").write_text(json.dumps(camera))


def mutate_image(place: Path, case: Path, rng: random.Random) -> None:
    """Change an image or its camera."""
    image = rng.choice(sorted(place.glob("a.*")))
    data, camera = image.read_bytes(), (place / "intrinsics.json").read_text()
    if rng.random() < 0.3:
        camera = mutate_text(camera, rng)
    elif image.suffix == ".npy":
        data = mutate_array(data, rng)
    else:
        data = mutate_bytes(data, rng)
    (case / image.name).write_bytes(data)
    (case / "intrinsics.json").write_bytes(camera.encode(errors="surrogateescape"))


def read_image(place: Path, case: Path) -> None:
    """Read a single depth image."""
    (image,) = case.glob("a.*")
    frame, _ = read_depth_image(image)
    expect_frame(frame)


def prepare_split(place: Path) -> None:
    """Write a SUN RGB-D collection of one image."""
    from scipy.io import savemat

    folder = place / "sun" / "SUNRGBD" / "kv1" / "a"
    frame = turn()[0][0]
    write_image(folder / "depth" / "a.png", frame)
    camera = frame.intrinsics
    K = (camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1)
    (folder / "intrinsics.txt").write_text(" ".join(map(str, K)))
    (folder / "scene.txt").write_text("kitchen")
    file = place / "sun" / "SUNRGBDtoolbox" / "traintestSUNRGBD" / "allsplit.mat"
    file.parent.mkdir(parents=True)
    names = np.array(["/n/SUNRGBD/kv1/a", "/n/SUNRGBD/kv1/b"], object)
    savemat(file, {"alltrain": names, "alltest": names[:1]})


def mutate_split(place: Path, case: Path, rng: random.Random) -> None:
    """Change the list of images, or one image's files."""
    shutil.copytree(place / "sun", case / "sun")
    file = next((case / "sun").rglob("allsplit.mat"))
    if rng.random() < 0.2:
        file = rng.choice(sorted((case / "sun" / "SUNRGBD").rglob("*.txt")))
    file.write_bytes(mutate_bytes(file.read_bytes(), rng))


def read_split(place: Path, case: Path) -> None:
    """Open the collection."""
    dataset = registry.open_dataset(case / "sun", "sunrgbd")
    for index in range(len(dataset)):
        expect_frame(dataset.frame(index))


READERS = {
    "map": Reader(12, prepare_map, damage_map, read_damaged_map),
    "map-signed": Reader(6, prepare_map, forge_map, read_forged_map),
    "model": Reader(8, prepare_models, damage_model, read_model),
    "model-inner": Reader(12, prepare_models, forge_model, read_model),
    "config": Reader(4, prepare_config, mutate_config, read_config),
    "archive": Reader(14, lambda place: None, mutate_archive, read_archive),
    "server": Reader(8, lambda place: None, mutate_answer, read_answer),
    "sequence": Reader(20, prepare_sequences, mutate_sequence, read_sequence),
    "image": Reader(15, prepare_images, mutate_image, read_image),
    "split": Reader(0.5, prepare_split, mutate_split, read_split),
}
"""Every reader, with its share of the cases; slow ones get few."""
