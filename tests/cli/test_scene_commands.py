"""``slam-bof train`` and ``evaluate scenes`` as their users meet them."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import pytest
from commands import refusal, slam_bof
from conftest import CAMERA
from labelled_boxes import SIZES_M, write_box

from slam_bof.core import registry
from slam_bof.scenes import LevelledClassifier, levelled_features, model, training
from slam_bof.scenes.mlp_ensemble import MlpEnsemble

QUICK = ("--words", 8, "--quiet")
BAGS = ("--descriptor", "bof")
"""The network on levelled views takes a quarter of a minute to learn, however little there is."""


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three classes of boxes, a sequence each with 20 frames; and a tour of two, with labels."""
    root = tmp_path_factory.mktemp("boxes")
    for label in SIZES_M:
        write_box(root / label / "seq-01", label, 20)
    for day in ("monday", "tuesday"):
        write_box(root / day / "seq-01", "hall", 10, turned=0.03 * len(day))
        rows = "".join(f"{k},{'left' if k % 2 else 'right'}\n" for k in range(10))
        (root / day / "seq-01" / "scenes.csv").write_text(f"frame,scene\n{rows}")
    return root


def labels(boxes: Path) -> list[str]:
    return [word for label in SIZES_M for word in ("--label", f"{label}={boxes / label}")]


def test_train_writes_a_model_and_prints_its_accuracy(boxes: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "boxes.bof"
    result = slam_bof("train", *labels(boxes), "-o", out, *BAGS, *QUICK, "--json")
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    assert said["model"] == str(out)
    assert said["classes"] == sorted(SIZES_M)
    assert [c["label"] for c in said["by_class"]] == sorted(SIZES_M)
    assert said["n_checked"] == 3 * 8
    assert said["accuracy"] > 0.5
    trained = model.load(out)
    assert trained.content_hash == said["content_sha256"]
    assert "hall/seq-01 (hall)" in trained.trained_on
    again = tmp_path / "again.bof"
    assert slam_bof("train", *labels(boxes), "-o", again, *BAGS, *QUICK).exit_code == 0
    assert again.read_bytes() == out.read_bytes()
    assert list(out.parent.iterdir()) == [out]


def train(boxes: Path, out: Path, *options: object) -> bytes:
    result = slam_bof("train", *labels(boxes), "-o", out, *BAGS, *QUICK, "--no-check", *options)
    assert result.exit_code == 0, result.output
    return out.read_bytes()


def test_the_model_does_not_depend_on_the_number_of_jobs(boxes: Path, tmp_path: Path) -> None:
    one, two = (train(boxes, tmp_path / f"{n}.bof", "--jobs", n) for n in (1, 2))
    assert one == two


def test_frames_are_described_on_a_cluster(boxes: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra dask")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        there = train(boxes, tmp_path / "there.bof", "--scheduler", cluster.scheduler_address)
    assert there == train(boxes, tmp_path / "here.bof")
    words = ("train", "--unlabelled", boxes / "hall", "-o", tmp_path / "words.bof", *QUICK)
    assert "found no scheduler" in refusal(*words, "--scheduler", "tcp://127.0.0.1:1")
    assert not (tmp_path / "words.bof").exists()


def test_train_searches_and_prints(boxes: Path, tmp_path: Path) -> None:
    out = tmp_path / "boxes.bof"
    page = tmp_path / "check"
    arguments = (*labels(boxes), "-o", out, "--words", 8, "--grid-search", "--page", page)
    result = slam_bof("train", *arguments)
    assert result.exit_code == 0, result.output
    assert "F1" in result.output
    assert "Labelled as" in result.output
    assert "24 frames kept from training" in (page / "scenes.html").read_text(encoding="utf-8")
    assert cv2.imread(str(page / "confusion_bag.png")).mean() > 0
    assert result.stdout.startswith("Grid search: svm-")
    assert "precision" in result.stdout
    assert f"Model: {out}" in result.stdout
    assert "Describing: 60/60" in result.stderr
    assert "Training: 3/3" in result.stderr


def test_train_learns_words_without_labels(boxes: Path, tmp_path: Path) -> None:
    out = tmp_path / "words.bof"
    paths = [p for label in SIZES_M for p in ("--unlabelled", boxes / label / "seq-01")]
    result = slam_bof("train", *paths, "-o", out, "--rounding", "nearest", *QUICK, "--json")
    assert result.exit_code == 0, result.output
    trained = model.load(out)
    assert json.loads(result.stdout)["content_sha256"] == trained.content_hash
    assert trained.bag_classifier is None
    assert trained.labeller() is None
    assert trained.places.layers.n_images == 21
    assert trained.vocabulary.n_words == len(trained.tf_idf.idf_)
    assert "expected it alone" in refusal("train", *paths, *labels(boxes), "-o", out)
    assert "cannot train on" in refusal("train", *paths, "-o", out, "--words", 100_000)


def test_train_continues_a_model(boxes: Path, tmp_path: Path) -> None:
    out = tmp_path / "more.bof"
    arguments = ("train", "--from", "synthetic", "-o", out, "--quiet", "--json")
    result = slam_bof(*arguments, *labels(boxes))
    assert result.exit_code == 0, result.output
    said, start = json.loads(result.stdout), model.resolve("synthetic")
    of_boxes = [row for row in said["by_class"] if row["n_frames"]]
    assert [row["label"] for row in of_boxes] == sorted(SIZES_M)
    assert said["accuracy"] > 0.8
    trained = model.load(out)
    assert {*start.levelled_classifier.network.classes_} < {*said["classes"]}
    assert trained.trained_on.startswith(start.trained_on)
    assert (trained.vocabulary.words_ == start.vocabulary.words_).all()
    assert slam_bof(*arguments, "--label", f"hall={boxes / 'hall'}").exit_code == 0
    assert "--from: found with" in refusal(*arguments, *labels(boxes), *BAGS)


def test_train_continues_a_model_of_an_earlier_version_with_shape_words(
    boxes: Path, tmp_path: Path
) -> None:
    names = [name for name in SIZES_M for _ in range(4)]
    datasets = {name: registry.open_dataset(boxes / name / "seq-01") for name in SIZES_M}
    views = [
        levelled_features(datasets[name].frame(5 * (k % 4)), with_shapes=True)
        for k, name in enumerate(names)
    ]
    network = MlpEnsemble(n_hidden=8, n_networks=1, n_steps=50, n_folds=2)
    with_words = LevelledClassifier.fit(views, names, n_words=6, network=network)
    start = tmp_path / "before.bof"
    model.save(replace(model.resolve("synthetic"), levelled_classifier=with_words), start)
    out = tmp_path / "after.bof"
    arguments = ("train", "--from", start, "-o", out, "--no-check", "--quiet")
    assert slam_bof(*arguments, *labels(boxes)).exit_code == 0
    before, after = (model.load(file).levelled_classifier for file in (start, out))
    assert (after.vocabulary.words_ == before.vocabulary.words_).all()
    frames = [(datasets[name].frame(k), name) for name in SIZES_M for k in range(20)]
    expected = before.continue_training(
        [levelled_features(frame, with_shapes=True) for frame, _ in frames],
        [name for _, name in frames],
    )
    assert (after.network.out_ == expected.network.out_).all(), "by the words of new frames too"


def test_train_by_table_with_another_classifier_and_layers(boxes: Path, tmp_path: Path) -> None:
    table = tmp_path / "labels.csv"
    table.write_text("".join(f"{boxes / label}/seq-01,{label}\n" for label in SIZES_M))
    out = tmp_path / "boxes.bof"
    arguments = ("--csv", table, "--classifier", "naive-bayes", "--layers", 3, "--no-check")
    result = slam_bof("train", *arguments, "-o", out, *QUICK, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["n_checked"] == 0
    trained = model.load(out)
    assert trained.places.layers.n_layers == 3
    assert trained.bag_classifier.classifier == "naive-bayes"
    assert trained.levelled_classifier is None
    picture = next((boxes / "hall" / "seq-01").glob("*.png"))
    given = ("--intrinsics", CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, "--depth-scale", 1000)
    answer = slam_bof("query", picture, "--model", out, *given, "--json")
    assert set(json.loads(answer.stdout)["probabilities"]) == set(SIZES_M)


def test_training_explains_mistakes(
    boxes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = ("-o", tmp_path / "x.bof", "--quiet")
    hall = ("--label", f"hall={boxes / 'hall'}")
    assert "found neither --label nor --csv" in refusal("train", *out)
    assert "'hall', expected NAME=PATH" in refusal("train", *out, "--label", "hall")
    assert "found nothing" in refusal("train", *out, "--label", f"hall={tmp_path / 'none'}")
    assert "found classes to train with: hall; expected at least two" in refusal(
        "train", *out, *hall
    )
    assert "--descriptor levelled: found with --classifier, expected bof" in refusal(
        "train", *out, *hall, "--descriptor", "levelled", "--classifier", "knn"
    )
    assert "--descriptor: found 'bof-layers', expected levelled or bof" in refusal(
        "train", *out, *hall, "--descriptor", "bof-layers", "--classifier", "mlp"
    )
    assert "--grid-search: found with --classifier knn" in refusal(
        "train", *out, *hall, "--grid-search", "--classifier", "knn"
    )
    assert "n_words must be at most" in refusal("train", *out, *labels(boxes), "--words", 100_000)
    assert "found a folder, expected the name of a file" in refusal(
        "train", *labels(boxes), "-o", tmp_path, "--quiet"
    )
    assert "/dev/null: found a device or pipe, expected the name of a file" in refusal(
        "train", *labels(boxes), "-o", "/dev/null", "--quiet"
    )
    assert f"{__file__}: File exists" in refusal(
        "train", *out, *labels(boxes), "--page", __file__, "--quiet"
    )
    assert slam_bof("train", *hall, "-o", "x.bof", "--classifier", "magic").exit_code == 2
    assert "--page: found without a check" in refusal(
        "train", *out, *labels(boxes), "--no-check", "--page", tmp_path
    )
    assert "--constellation: found with" in refusal(
        "train", *out, *labels(boxes), "--constellation", *BAGS
    )
    monkeypatch.setitem(sys.modules, "torch", None)
    assert "pip install 'slam-bof[train]'" in refusal(
        "train", *out, *labels(boxes), "--constellation"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_set_transformer_is_trained_and_labels_a_run(
    boxes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch", reason="PyTorch (extra train) is not installed")
    quick = partial(training.TransformerTraining, n_steps=40)
    monkeypatch.setattr(training, "TransformerTraining", quick)
    out = tmp_path / "boxes.bof"
    options = ("--constellation", "--no-check", *QUICK)
    assert slam_bof("train", *labels(boxes), "-o", out, *options).exit_code == 0
    labeller = model.load(out).labeller("constellation")
    assert labeller is not None
    run = ("run", boxes / "hall" / "seq-01", "--model", out, "--out", tmp_path / "runs")
    done = slam_bof(*run, "--set", "labels.by=constellation", "--quiet", "--json")
    assert done.exit_code == 0, done.output
    found = slam_bof("query", "keyframes", tmp_path / "runs" / "latest" / "map.db", "--json")
    assert json.loads(found.stdout)
    refused = refusal(*run[:2], "--out", tmp_path / "no", "--set", "labels.by=constellation")
    assert "found no classifier of constellations" in refused


@pytest.mark.parametrize("protocol", ["holdout", "time-split"])
def test_evaluate_scenes_prints_tables_and_writes_pictures(
    boxes: Path, tmp_path: Path, protocol: str
) -> None:
    arguments = ("--protocol", protocol, "--methods", "bof,thumbnail,sift,bof:knn", *QUICK)
    result = slam_bof("evaluate", "scenes", *labels(boxes), *arguments, "-o", tmp_path)
    assert result.exit_code == 0, result.output
    assert "Recall by class" in result.stdout
    assert "sift is left out: no colour images" in result.stdout
    assert (tmp_path / "scenes.html").is_file()
    assert cv2.imread(str(tmp_path / "confusion_bof.png")) is not None
    assert cv2.imread(str(tmp_path / "confusion_bof_knn.png")) is not None


def test_one_day_and_another(boxes: Path) -> None:
    days = ("--train", boxes / "monday", "--test", boxes / "tuesday")
    tour = ("--protocol", "tour", "--methods", "thumbnail", "--json", "--quiet")
    said = json.loads(slam_bof("evaluate", "scenes", *tour, *days).stdout)
    assert (said["n_train"], said["n_test"], said["classes"]) == (10, 10, ["left", "right"])
    assert set(said["methods"]["thumbnail"]["auc"]) == {"left", "right"}
    named = ("--label", f"left={boxes / 'hall'}", "--label", f"right={boxes / 'office'}")
    more = ("--test", f"left={boxes / 'monday'}")
    said = json.loads(slam_bof("evaluate", "scenes", *tour, *named, *more).stdout)
    assert (said["n_train"], said["n_test"]) == (40, 10)


def test_evaluation_explains_mistakes(boxes: Path, tmp_path: Path) -> None:
    def said(protocol: str, *arguments: object) -> str:
        return refusal("evaluate", "scenes", "--protocol", protocol, "--quiet", *arguments)

    assert "--protocol holdout: found no --csv or --label" in said("holdout")
    assert "--protocol synthetic: found --data, expected none" in said("synthetic", "--data", "x")
    assert "found no --csv or --label or --train and --test" in said("tour", "--train", "x")
    assert "TrainSplit.txt: found no such file" in said("unseen", *labels(boxes))
    assert "x: found nothing" in said("sunrgbd", "--data", "x")
    assert "no descriptors plug-in 'magic'" in said("holdout", *labels(boxes), "--methods", "magic")
    assert "found no classifier 'magic', expected one of svm-linear" in said(
        "holdout", *labels(boxes), "--methods", "bof:magic"
    )
    assert slam_bof("evaluate", "scenes", "--protocol", "magic").exit_code == 2


def test_images_by_room(boxes: Path, tmp_path: Path) -> None:
    table = tmp_path / "labels.csv"
    images = {label: sorted((boxes / label / "seq-01").glob("*.png")) for label in SIZES_M}
    rows = [
        f"{file},{label},{label}-{k % 4}"
        for label, files in images.items()
        for k, file in enumerate(files[:8])
    ]
    table.write_text("\n".join(["file,scene,group", *rows]))
    camera = tmp_path / "camera.json"
    fields = ("width", "height", "fx", "fy", "cx", "cy")
    camera.write_text(json.dumps({name: getattr(CAMERA, name) for name in fields}))
    groups = ("evaluate", "scenes", "--protocol", "groups", "--csv", table, "--camera", camera)
    quick = ("--methods", "ours", "--folds", 2, "--repeats", 1, "--copies", 0, "--quiet")
    said = json.loads(slam_bof(*groups, *quick, "--out", tmp_path / "page", "--json").stdout)
    assert (said["n_images"], said["n_groups"], said["classes"]) == (24, 12, sorted(SIZES_M))
    assert said["methods"]["ours"]["accuracy"] > 0.5
    assert (tmp_path / "page" / "confusion_ours.png").is_file()
    assert "Recall by class" in slam_bof(*groups, *quick, "--classes", "hall,store").stdout
    tested = json.loads(slam_bof(*groups, "--model", "default", "--quiet", "--json").stdout)
    assert [row["label"] for row in tested["by_class"]] == sorted(SIZES_M)
    assert "unknown_auroc" in slam_bof(*groups, "--model", "default", "--quiet").stdout
    assert "--classes: found no images of cave" in refusal(*groups, "--classes", "cave,hall")
    out = tmp_path / "boxes.bof"
    trained = slam_bof("train", "--csv", table, "--camera", camera, "-o", out, "--copies", 0,
                       *QUICK, "--json")  # fmt: skip
    assert json.loads(trained.stdout)["n_checked"] == 6
    assert model.load(out).trained_on == "24 images of labels.csv"
