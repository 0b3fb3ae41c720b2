"""Model files: damaged ones, and broken contents under a right hash."""

from __future__ import annotations

import json
import random
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from fuzzing.cases import Reader, expect, turn, write_image
from fuzzing.mutations import mutate_array, mutate_bytes, mutate_json
from slam_bof.bof import LayerParams, PlaceParams
from slam_bof.datasets import read_depth_image
from slam_bof.scenes import (
    ConstellationClassifier,
    FrameDescriptors,
    SceneClassifier,
    fit_model,
    model as models,
)
from slam_bof.scenes.contour_tokens import N_TOKEN_VALUES
from slam_bof.scenes.height_profile import N_PROFILE_VALUES
from slam_bof.scenes.model_file import ModelContent
from slam_bof.scenes.set_transformer import SetTransformer, TransformerShape
from slam_bof.scenes.stored_classifier import read_entries, zip_entries

__all__ = ["READERS"]

CLASSIFIERS = ("svm-linear", "svm-rbf", "random-forest", "knn", "mlp", "naive-bayes")


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
    attending = replace(models.load(data), constellation_classifier=_untrained(rng))
    models.save(attending, place / "constellation.bof")
    write_image(place / "frame.png", turn()[0][0])


def _untrained(rng: np.random.Generator) -> ConstellationClassifier:
    """Return a classifier of constellations with random weights."""
    shape = TransformerShape(n_profile=N_PROFILE_VALUES, n_token=N_TOKEN_VALUES, n_classes=3)
    values = np.zeros(N_PROFILE_VALUES + N_TOKEN_VALUES, np.float32)
    weights = {k: 0.1 * rng.standard_normal(n, np.float32) for k, n in shape.weights().items()}
    return ConstellationClassifier(
        SetTransformer(shape, weights, values, values + 1), tuple("abc"), 1.0
    )


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
        manifest["content_sha256"] = ModelContent(content, entries).sha256
    entries = {"manifest.json": json.dumps(manifest).encode(), **entries}
    (case / "m.bof").write_bytes(zip_entries(entries, zipfile.ZIP_DEFLATED))


def read_model(place: Path, case: Path) -> None:
    """Load a model; its labels must be probabilities."""
    model = models.load(case / "m.bof")
    frame, _ = read_depth_image(place / "frame.png", intrinsics=(140.0, 140.0, 79.5, 59.5))
    with np.errstate(all="ignore"):
        bag = model.describer().describe(frame) if model.places.layers.axis != "gravity" else None
        if bag is None:
            return
        labellers = (model.labeller(), model.constellation_classifier)
        scenes = [each.label(frame, bag=bag) for each in labellers if each is not None]
    expect(bool(np.isfinite(bag.weights).all()), "weights of a bag")
    for scene in scenes:
        p = scene.probabilities
        expect(bool(np.isfinite(p).all() and p.min() >= 0), "probabilities")
        expect(abs(float(p.sum()) - 1.0) < 1e-3, "sum of probabilities")
        expect(scene.label in scene.classes, "label")


READERS = {
    "model": Reader(8, prepare_models, damage_model, read_model),
    "model-inner": Reader(6, prepare_models, forge_model, read_model),
}
