import copy
import hashlib
import io
import json
import string
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam_bof.bof import LayerParams, PlaceParams
from slam_bof.errors import ModelError
from slam_bof.scenes import (
    FrameDescriptors,
    LevelledFeatures,
    SceneClassifier,
    fit_model,
    model as models,
)
from slam_bof.scenes.height_profile import N_PROFILE_VALUES
from slam_bof.scenes.labeller import BagLabeller
from slam_bof.scenes.shape_words import N_SHAPE_VALUES
from slam_bof.synthetic import ROOM_KINDS, messy_views, training_views

PARAMS = PlaceParams(layers=LayerParams(n_layers=3))


def train(seed=0, scenes=None, labelled=True, levelled=False):
    rng = np.random.default_rng(0)
    n_frames, each = 60, 6
    kinds = np.arange(n_frames) % 3
    values = rng.random((n_frames, each, 180)) * 0.3
    values[np.arange(n_frames), :, kinds * 60] += 1.0
    labels = tuple("abc"[k] if labelled else None for k in kinds)
    groups = tuple(f"seq-{i // 6}" for i in range(n_frames))
    views = tuple(
        LevelledFeatures(
            np.full(N_PROFILE_VALUES, k, np.float32),
            np.full((2, N_SHAPE_VALUES), k + i, np.float32),
        )
        for i, k in enumerate(kinds)
        if levelled
    )
    described = FrameDescriptors(
        values.reshape(-1, 180).astype(np.float32), np.full(n_frames, each), labels, groups, views
    )
    return fit_model(
        described, PARAMS, n_words=12, seed=seed, trained_on="random shapes", bag_classifier=scenes
    )


@pytest.fixture(scope="module")
def model():
    return train()


@pytest.fixture
def file(model, tmp_path):
    models.save(model, tmp_path / "test.bof")
    return tmp_path / "test.bof"


def rewrite(file, change):
    """Change the entries of a model file, as {name: bytes}."""
    with zipfile.ZipFile(file) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    change(entries)
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)


@pytest.mark.parametrize("scenes", [None, SceneClassifier(kernel="rbf")])
def test_what_is_saved_is_what_is_loaded(tmp_path, scenes):
    model = train(scenes=scenes)
    models.save(model, tmp_path / "test.bof")
    loaded = models.load(tmp_path / "test.bof")
    assert loaded.places == model.places
    assert loaded.trained_on == "random shapes"
    assert loaded.content_hash == model.content_hash
    assert loaded.vocabulary.get_params() == model.vocabulary.get_params()
    np.testing.assert_array_equal(loaded.vocabulary.words_, model.vocabulary.words_)
    np.testing.assert_array_equal(loaded.tf_idf.idf_, model.tf_idf.idf_)
    bag = model.tf_idf.bag(np.array([0, 3, 3, 7], np.int32))
    np.testing.assert_array_equal(
        loaded.bag_classifier.predict_bag(bag).probabilities,
        model.bag_classifier.predict_bag(bag).probabilities,
    )


@pytest.fixture(scope="module")
def levelled():
    return train(levelled=True)


def test_what_labels_levelled_views_is_kept_as_arrays(tmp_path, levelled):
    model = levelled
    models.save(model, tmp_path / "test.bof")
    loaded = models.load(tmp_path / "test.bof")
    view = LevelledFeatures(
        np.full(N_PROFILE_VALUES, 1.0, np.float32), np.full((2, N_SHAPE_VALUES), 5, np.float32)
    )
    expected, found = (m.levelled_classifier.label_features(view) for m in (model, loaded))
    assert found.label == expected.label == "b"
    np.testing.assert_array_equal(found.probabilities, expected.probabilities)
    assert loaded.labeller() is loaded.levelled_classifier
    assert isinstance(loaded.labeller("bag"), BagLabeller)
    with pytest.raises(ModelError, match="found no classifier of bags, expected one"):
        replace(loaded, bag_classifier=None).labeller("bag")
    models.save(loaded, tmp_path / "again.bof")
    assert (tmp_path / "again.bof").read_bytes() == (tmp_path / "test.bof").read_bytes()


def test_levels_that_do_not_fit_are_no_model(tmp_path, levelled):
    network = copy.copy(levelled.levelled_classifier.network)
    network.hidden_ = network.hidden_[:, :-1]
    levels = replace(levelled.levelled_classifier, network=network)
    models.save(replace(levelled, levelled_classifier=levels), tmp_path / "test.bof")
    with pytest.raises(ModelError, match=r"not as expected: levels/hidden must be"):
        models.load(tmp_path / "test.bof")


def test_a_loaded_model_saves_to_the_same_bytes(file, tmp_path):
    models.save(models.load(file), tmp_path / "again.bof")
    assert (tmp_path / "again.bof").read_bytes() == file.read_bytes()


def test_the_same_training_gives_the_same_bytes_in_another_process(file, tmp_path):
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_model as t; "
        "padding = [object() for _ in range(1000)]; "
        "t.models.save(t.train(), sys.argv[2])"
    )
    other = tmp_path / "other.bof"
    here = str(Path(__file__).parent)
    subprocess.run([sys.executable, "-c", program, here, str(other)], check=True)
    assert other.read_bytes() == file.read_bytes()


def test_another_seed_gives_another_hash(model):
    assert train(seed=1).content_hash != model.content_hash


def test_a_model_needs_no_labels(tmp_path):
    models.save(train(labelled=False), tmp_path / "test.bof")
    loaded = models.load(tmp_path / "test.bof")
    assert loaded.bag_classifier is None
    assert loaded.labeller() is None


def test_the_file_holds_arrays_and_json_only(file):
    with zipfile.ZipFile(file) as archive:
        assert set(archive.namelist()) == {"manifest.json", "words.npy", "idf.npy", "scenes.skops"}
        with zipfile.ZipFile(io.BytesIO(archive.read("scenes.skops"))) as scenes:
            for name in scenes.namelist():
                data = io.BytesIO(scenes.read(name))
                json.load(data) if name == "schema.json" else np.load(data, allow_pickle=False)


def test_saving_leaves_no_unfinished_file(file):
    assert [p.name for p in file.parent.iterdir()] == [file.name]


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(ModelError, match=r"none\.bof: no such model file$"):
        models.load(tmp_path / "none.bof")
    with pytest.raises(ModelError, match=r"cannot be read: Is a directory$"):
        models.load(tmp_path)


def no_manifest(file):
    rewrite(file, lambda entries: entries.pop("manifest.json"))


def broken_manifest(file):
    rewrite(file, lambda entries: entries.update({"manifest.json": b"[1, 2"}))


def manifest_of_another_kind(file):
    rewrite(file, lambda entries: entries.update({"manifest.json": b"[1, 2]"}))


def text(file):
    file.write_text("not a zip")


def cut(file):
    file.write_bytes(file.read_bytes()[:-50])


@pytest.mark.parametrize(
    "damage", [no_manifest, broken_manifest, manifest_of_another_kind, text, cut]
)
def test_what_is_no_model_is_refused(file, damage):
    damage(file)
    with pytest.raises(ModelError, match=r"test\.bof: not a model file; expected a zip"):
        models.load(file)


def edit_manifest(file, **changes):
    def change(entries):
        manifest = json.loads(entries["manifest.json"])
        manifest.update(changes)
        entries["manifest.json"] = json.dumps(manifest).encode()

    rewrite(file, change)


def test_another_version_is_refused_with_found_and_expected(file):
    edit_manifest(file, format_version=99)
    with pytest.raises(ModelError, match=r"found .* format version 99, expected .* version 1"):
        models.load(file)


def test_changed_content_is_refused(file):
    rewrite(file, lambda entries: entries.update({"idf.npy": entries["idf.npy"][:-1] + b"\x01"}))
    with pytest.raises(ModelError, match=r"test\.bof: damaged: found content hash \w+, expected"):
        models.load(file)


def test_changed_parameters_are_refused(file):
    edit_manifest(file, places=PlaceParams().model_dump(mode="json"))
    with pytest.raises(ModelError, match="damaged"):
        models.load(file)


def test_a_damaged_byte_is_refused(file):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(ModelError, match=r"test\.bof: (not a model file|damaged)"):
        models.load(file)


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_damaged_compression_is_refused(file, method):
    file.write_bytes(b"")
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("manifest.json", json.dumps({"format": list(range(2000))}))
    data = bytearray(file.read_bytes())
    for at in range(50, 80):  # past the header of the entry
        data[at] ^= 0x55
    file.write_bytes(data)
    with pytest.raises(ModelError, match="not a model file"):
        models.load(file)


def test_a_type_that_is_not_trusted_is_refused(file):
    import skops.io

    stranger = skops.io.dumps(string.Template("x"))
    with zipfile.ZipFile(file) as archive:
        manifest = json.loads(archive.read("manifest.json"))
        entries = {name: archive.read(name) for name in ("words.npy", "idf.npy")}
    entries["scenes.skops"] = stranger
    content = {k: v for k, v in manifest.items() if k not in ("content_sha256", "made_with")}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for name in sorted(entries):
        digest.update(f"\n{name} {len(entries[name])}\n".encode() + entries[name])
    rewrite(file, lambda old: old.update(entries))
    edit_manifest(file, content_sha256=digest.hexdigest())
    with pytest.raises(ModelError, match=r"content is not as expected: .*string.Template"):
        models.load(file)


@pytest.mark.parametrize(("name", "n_classes"), [("default", 9), ("synthetic", 7)])
def test_the_included_models(name, n_classes):
    model = models.resolve(name)
    assert "synthetic rooms" in model.trained_on
    assert model.vocabulary.words_.shape == (model.vocabulary.n_words, 180)
    view = next(training_views("office", 590, 1))
    scene = model.labeller().label(view)
    assert len(scene.classes) == n_classes
    assert scene.probabilities.sum() == pytest.approx(1.0)
    assert models.name_by_hash("default", model.content_hash) == name


def test_earlier_models_are_replaced_by_those_with_their_words():
    for content_hash, name in models.SUPERSEDED.items():
        assert models.name_by_hash("default", content_hash) == name
        assert models.name_by_hash("mine.bof", content_hash) == "mine.bof"
        assert models.has_words_of(content_hash, name)
        assert not models.has_words_of(content_hash, "mine.bof")
    assert set(models.SUPERSEDED.values()) == {"default", "synthetic"}
    assert models.name_by_hash("default", "another") == "default"
    assert models.name_by_hash("default", None) == "default"
    assert models.name_by_hash("mine.bof", models.resolve("synthetic").content_hash) == "mine.bof"


@pytest.mark.parametrize("name", ["default", "synthetic"])
def test_the_included_models_have_the_words_of_earlier_ones(name):
    model = models.resolve(name)
    digest = hashlib.sha256(model.vocabulary.words_.tobytes() + model.tf_idf.idf_.tobytes())
    assert digest.hexdigest()[:12] == "aa064efee7f3"
    assert model.content_hash not in models.SUPERSEDED
    assert model.levelled_classifier.vocabulary is None


def test_the_synthetic_model_tells_rooms_it_has_not_seen():
    labeller = models.resolve("synthetic").labeller()
    views = [(kind, f) for kind in ("bathroom", "corridor") for f in training_views(kind, 590, 3)]
    together = {kind: 0.0 for kind, _ in views}
    for kind, frame in views:
        scene = labeller.label(frame)
        together[kind] = together[kind] + np.log(scene.probabilities)
    assert [scene.classes[total.argmax()] for total in together.values()] == list(together)


def test_the_default_model_is_rarely_wrong_and_sure():
    """Of messy rooms that it has not seen it knows fewer, and says so."""
    labeller = models.resolve().labeller()
    views = [(k, *v) for k in ROOM_KINDS for s in (9000, 9001) for v in messy_views(k, s, 2)]
    scenes = [labeller.label(frame, gravity_camera=down) for _, frame, down in views]
    right = np.array([s.label == kind for s, (kind, *_) in zip(scenes, views, strict=True)])
    sure = np.array([scene.probability for scene in scenes]) > 0.6
    assert right.mean() > 0.35
    assert (sure & ~right).mean() < 0.1
