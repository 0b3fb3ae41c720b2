"""Model files whose hash is right and whose content is not: from anybody, or from a bad tool."""

from __future__ import annotations

import io
import json
import random
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from set_transformers import random_classifier
from test_model import train

from slam_bof.errors import ModelError
from slam_bof.scenes import SceneClassifier, classifier_bytes, model as models
from slam_bof.scenes.model_file import ModelContent
from slam_bof.scenes.stored_classifier import read_entries, zip_entries

Entries = dict[str, bytes]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Model files by their classifier."""
    folder = tmp_path_factory.mktemp("trained")
    for name in ("svm-linear", "svm-rbf", "random-forest", "knn"):
        scenes = SceneClassifier(classifier=name, n_folds=2)
        model = train(scenes=scenes, levelled=name == "svm-linear")
        if name == "svm-linear":
            model = replace(model, constellation_classifier=random_classifier(("a", "b", "c")))
        models.save(model, folder / f"{name}.bof")
    return {file.stem: file for file in folder.iterdir()}


def save(entries: Entries, path: Path) -> Path:
    """Write a model file whose hash is right."""
    entries = dict(entries)
    manifest = json.loads(entries.pop("manifest.json"))
    content = {k: v for k, v in manifest.items() if k not in ("content_sha256", "made_with")}
    manifest["content_sha256"] = ModelContent(content, entries).sha256
    entries["manifest.json"] = json.dumps(manifest).encode()
    path.write_bytes(zip_entries(entries, zipfile.ZIP_DEFLATED))
    return path


def refused(entries: Entries, path: Path) -> str:
    """Return what a ``ModelError`` says of a model file with these entries."""
    with pytest.raises(ModelError, match=r"broken\.bof: ") as caught:
        models.load(save(entries, path / "broken.bof"))
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 600
    return message


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def load_npy(data: bytes) -> Any:
    return np.load(io.BytesIO(data))


VALUES = [
    ("levels/hidden", np.nan),
    ("levels/temperature", 0),
    ("levels/temperature", np.nan),
    ("levels/temperature", -1),
    ("levels/temperature", 1e-30),
    ("levels/scale", 0),
    ("levels/scale", 1e-30),
    ("levels/hidden", -1e38),
    ("levels/out", 1e38),
    ("levels/mean", 1e30),
    ("constellation/temperature", 0),
    ("constellation/scales", 0),
    ("constellation/merge_0", 1e38),
    ("constellation/out_bias", np.nan),
    ("idf", 1e38),
    ("words", np.nan),
    ("words", np.inf),
    ("idf", np.nan),
    ("idf", -1),
]


@pytest.mark.parametrize(("name", "value"), VALUES)
def test_numbers_that_mean_nothing_are_refused(
    trained: dict[str, Path], tmp_path: Path, name: str, value: float
) -> None:
    entries = read_entries(trained["svm-linear"].read_bytes())
    array = np.full_like(load_npy(entries[f"{name}.npy"]), value)
    assert name in refused({**entries, f"{name}.npy": npy(array)}, tmp_path)


def test_whatever_an_entry_is_the_message_names_it(
    trained: dict[str, Path], tmp_path: Path
) -> None:
    entries = read_entries(trained["svm-linear"].read_bytes())
    rng = random.Random(0)
    for name in sorted(set(entries) - {"manifest.json"}):
        data = entries[name]
        for broken in (
            b"",
            data[: rng.randrange(len(data))],
            rng.randbytes(100),
            b"\x93NUMPY\x01\0\x10\0{'descr': '<f8', ",
            npy(np.array(["text"])),
            npy(np.zeros((0, 3))),
        ):
            assert name.removesuffix(".npy") in refused({**entries, name: broken}, tmp_path)


def test_a_header_that_promises_terabytes_allocates_nothing(
    trained: dict[str, Path], tmp_path: Path
) -> None:
    entries = read_entries(trained["svm-linear"].read_bytes())
    data = entries["idf.npy"].replace(b"(12,)", b"(9999999999999,)")
    assert "idf.npy: found" in refused({**entries, "idf.npy": data}, tmp_path)


@pytest.mark.parametrize("key", ["format", "format_version"])
def test_a_format_of_thousands_of_characters_is_shown_in_part(
    trained: dict[str, Path], tmp_path: Path, key: str
) -> None:
    entries = read_entries(trained["svm-linear"].read_bytes())
    manifest = json.loads(entries["manifest.json"]) | {key: "x" * 9000}
    refused({**entries, "manifest.json": json.dumps(manifest).encode()}, tmp_path)


def inside(entries: Entries, change: Callable[[Entries, Any], None]) -> Entries:
    """Return the entries after changing the files and the schema in ``scenes.skops``."""
    files = read_entries(entries["scenes.skops"])
    schema = json.loads(files["schema.json"])
    change(files, schema)
    files["schema.json"] = json.dumps(schema).encode()
    return {**entries, "scenes.skops": zip_entries(files, zipfile.ZIP_STORED)}


def nodes_of(schema: Any, loader: str) -> list[Any]:
    if isinstance(schema, dict):
        own = [schema] if schema.get("__loader__") == loader else []
        return own + [n for child in schema.values() for n in nodes_of(child, loader)]
    if isinstance(schema, list):
        return [n for child in schema for n in nodes_of(child, loader)]
    return []


def far_child(files: Entries, schema: Any) -> None:
    for name, data in files.items():
        array = load_npy(data) if name.endswith(".npy") else np.empty(0)
        if array.dtype.names and len(array) > 1:
            array["left_child"][0] = array["right_child"][0] = 2**31
            files[name] = npy(array)


def endless_path(files: Entries, schema: Any) -> None:
    for name, data in files.items():
        array = load_npy(data) if name.endswith(".npy") else np.empty(0)
        if array.dtype.names and len(array) > 1:
            array["left_child"][0] = array["right_child"][0] = 0
            files[name] = npy(array)


def more_nodes(files: Entries, schema: Any) -> None:
    state = nodes_of(schema, "TreeNode")[0]["content"]["content"]
    state["node_count"]["content"] = "100000000"


def more_outputs(files: Entries, schema: Any) -> None:
    args = nodes_of(schema, "TreeNode")[0]["__reduce__"]["args"]["content"]
    args[2]["content"] = "100000000"


@pytest.mark.parametrize("change", [far_child, endless_path, more_nodes, more_outputs])
def test_a_tree_that_leads_out_of_its_memory_is_refused(
    trained: dict[str, Path], tmp_path: Path, change: Callable[[Entries, Any], None]
) -> None:
    entries = inside(read_entries(trained["random-forest"].read_bytes()), change)
    assert "scenes.skops: ValueError: found an implausible" in refused(entries, tmp_path)


def stranger(files: Entries, schema: Any) -> None:
    nodes_of(schema, "ObjectNode")[-1].update(
        {"__module__": "sklearn.neighbors._kd_tree", "__class__": "KDTree"}
    )


def no_file(files: Entries, schema: Any) -> None:
    nodes_of(schema, "NdArrayNode")[0]["file"] = "../../secret.npy"


def deep(files: Entries, schema: Any) -> None:
    nest: Any = schema
    for _ in range(900):
        nest["content"] = {"__class__": "dict", "__module__": "builtins", "__loader__": "DictNode"}
        nest = nest["content"]


def same_id(files: Entries, schema: Any) -> None:
    """skops would take the first of the two for both."""
    first, second = nodes_of(schema, "NdArrayNode")[:2]
    second["__id__"] = first["__id__"]


@pytest.mark.parametrize("change", [stranger, no_file, deep, same_id])
def test_a_schema_of_something_else_is_refused(
    trained: dict[str, Path], tmp_path: Path, change: Callable[[Entries, Any], None]
) -> None:
    entries = inside(read_entries(trained["svm-linear"].read_bytes()), change)
    assert "scenes.skops: " in refused(entries, tmp_path)


def attribute(name: str, value: Any) -> Callable[[Any], None]:
    return lambda estimator: setattr(estimator, name, value(getattr(estimator, name)))


ESTIMATORS = [
    ("svm-rbf", attribute("_n_support", lambda old: np.full(len(old), 10**7, np.int32))),
    ("svm-rbf", attribute("_dual_coef_", lambda old: old[:, :1])),
    ("svm-rbf", attribute("_gamma", lambda old: np.float64("nan"))),
    ("svm-rbf", attribute("support_vectors_", lambda old: old[:, :2])),
    ("knn", attribute("_y", lambda old: np.full(len(old), 10**9))),
    ("knn", attribute("_fit_X", lambda old: old[:1])),
    ("svm-linear", attribute("coef_", lambda old: old * np.nan)),
    ("svm-linear", attribute("coef_", lambda old: old[:, 1:])),
    ("random-forest", attribute("estimators_", lambda old: [])),
]


@pytest.mark.parametrize(("name", "change"), ESTIMATORS)
def test_an_estimator_that_contradicts_itself_is_refused(
    trained: dict[str, Path], tmp_path: Path, name: str, change: Callable[[Any], None]
) -> None:
    classifier = models.load(trained[name]).bag_classifier
    change(classifier.classifier_.calibrated_classifiers_[0].estimator)
    entries = read_entries(trained[name].read_bytes())
    entries["scenes.skops"] = classifier_bytes(classifier)
    assert "scenes.skops: " in refused(entries, tmp_path)


@pytest.mark.parametrize("name", ["svm-linear", "svm-rbf", "random-forest", "knn"])
def test_calibration_must_be_of_numbers(
    trained: dict[str, Path], tmp_path: Path, name: str
) -> None:
    classifier = models.load(trained[name]).bag_classifier
    classifier.classifier_.calibrated_classifiers_[0].calibrators[0].a_ = np.float64("nan")
    entries = read_entries(trained[name].read_bytes())
    entries["scenes.skops"] = classifier_bytes(classifier)
    assert "found an implausible calibrators" in refused(entries, tmp_path)


def test_a_bomb_is_not_unpacked(trained: dict[str, Path], tmp_path: Path) -> None:
    entries = read_entries(trained["svm-linear"].read_bytes())
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
        with archive.open("zeros", "w", force_zip64=True) as bomb:
            for _ in range(300):
                bomb.write(bytes(1 << 20))
    (tmp_path / "bomb.bof").write_bytes(packed.getvalue())
    with pytest.raises(ModelError, match=r"bomb\.bof: not a model file"):
        models.load(tmp_path / "bomb.bof")
