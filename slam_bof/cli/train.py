"""``slam-bof train``: a model file from labelled depth frames."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slam_bof.cli.options import CAMERA, COPIES, EVERY, JSON, N_WORDS, QUIET, SEED
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    from slam_bof.evaluation import TrainedSceneModel

__all__ = ["train"]

Rounding = Literal["floor", "nearest"]
Classifier = Literal["svm-linear", "svm-rbf", "random-forest", "naive-bayes", "knn", "mlp"]


def train(
    out: Annotated[Path, typer.Option("--out", "-o", help="The model file to write.")],
    label: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PATH",
            help="A class and its data: a sequence, a folder of sequences (seq-XX), or a folder "
            "of depth images with intrinsics.json. May be given several times, also for one class.",
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with rows path,label; sequences or depth images, relative to the file. "
            "Or with a header: file, scene, group (the room) and, if known, R00 to R22 (camera to "
            "level, y down), one depth image a row; some rooms are then kept to test with."
        ),
    ] = None,
    unlabelled: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="PATH",
            help="Learn words and idf alone, without labels, on a sequence, a folder of sequences "
            "or one of depth images, as the paper does for loops. May be given several times.",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="MODEL",
            help="Continue this model, a file or default or synthetic, instead of training a new "
            "one. It keeps its words and classes, and learns further classes.",
        ),
    ] = None,
    camera: CAMERA = None,
    copies: COPIES = 3,
    descriptor: Annotated[
        str | None,
        typer.Option(
            metavar="levelled|bof",
            help="Features of the classifier: levelled views, the default, or bof, the bags of "
            "words of the paper, the default with --classifier or --grid-search.",
        ),
    ] = None,
    constellation: Annotated[
        bool,
        typer.Option(
            "--constellation",
            help="Also train a set transformer on the BOFs of a view, with PyTorch (extra train). "
            "run labels by it with --set labels.by=constellation.",
        ),
    ] = False,
    layers: Annotated[
        int | None, typer.Option(min=1, help="Layers of a frame's point cloud; by default 20.")
    ] = None,
    rounding: Annotated[
        Rounding,
        typer.Option(
            help="How points get their layer: floor makes layers of one thickness; nearest, the "
            "paper's, one more, of which the first and the last are half as thick."
        ),
    ] = "floor",
    n_words: N_WORDS = 1024,
    classifier: Annotated[
        Classifier | None,
        typer.Option(
            help="Classifier of bags of words; by default svm-linear. mlp is a neural network on "
            "bags; evaluate scenes --methods bof-layers:mlp tests one on the BOF of each layer."
        ),
    ] = None,
    grid_search: Annotated[
        bool,
        typer.Option(
            "--grid-search",
            help="Choose between a linear and a Gaussian support vector machine on bags of words, "
            "and C and gamma, by cross-validation.",
        ),
    ] = False,
    every: EVERY = 1,
    check: Annotated[
        bool,
        typer.Option(
            "--check/--no-check",
            help="First train on 60 % of each sequence and test on its end, after a gap; of "
            "images with groups, train on three quarters of the rooms and test on the others.",
        ),
    ] = True,
    page: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder for a page with the results of the check, and the confusion matrix as "
            "a PNG image.",
        ),
    ] = None,
    seed: SEED = 0,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, help="Number of frames described at a time.")
    ] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT",
            help="Describe frames on the Dask cluster of this scheduler (extra dask). They are "
            "read here. The model is the same.",
        ),
    ] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Train a model on labelled depth frames: vocabulary, idf and scene classifier in one file.

    The accuracy printed is that of a model trained in the same way on a part of the frames and
    tested on the others.
    """
    of_bags = grid_search or classifier is not None
    _check_descriptor(descriptor, classifier, grid_search=grid_search)
    if unlabelled and (label or csv is not None or of_bags or descriptor == "levelled"):
        raise ConfigError("--unlabelled: found with options for labels, expected it alone")
    if not label and csv is None and not unlabelled:
        raise ConfigError(
            "found neither --label nor --csv, expected --label NAME=PATH, or --unlabelled PATH"
        )
    if start is not None and (unlabelled or of_bags or descriptor == "bof" or layers):
        raise ConfigError(
            "--from: found with --unlabelled or options for bags or layers, expected it without: "
            "the words of a model stay, and its levelled classifier continues"
        )
    if constellation and (unlabelled or of_bags or descriptor == "bof" or start is not None):
        raise ConfigError(
            "--constellation: found with --unlabelled, --from or options for bags, expected it "
            "with levelled views"
        )
    if page is not None and (unlabelled or not check):
        raise ConfigError("--page: found without a check, expected --check and labels")
    from slam_bof.bof import LayerParams, PlaceParams
    from slam_bof.cli.console import Bars
    from slam_bof.core import on_cluster
    from slam_bof.datasets import (
        frames_of,
        has_groups,
        open_labelled,
        open_sequences,
        parse_label,
        read_image_table,
        read_label_file,
    )
    from slam_bof.evaluation import TrainedSceneModel, train_scene_model, train_words
    from slam_bof.scenes import import_torch, model as models

    if constellation:
        import_torch()
    _check_out(out)
    if page is not None:
        page.mkdir(parents=True, exist_ok=True)  # before the work of minutes
    n_layers = LayerParams().n_layers if layers is None else layers
    params = PlaceParams(layers=LayerParams(n_layers=n_layers, rounding=rounding))
    n_jobs = jobs if scheduler is None else None
    cluster = nullcontext() if scheduler is None else on_cluster(scheduler)
    if unlabelled:
        with cluster, Bars(quiet=quiet) as bars:
            model = train_words(
                [dataset for path in unlabelled for dataset in open_sequences(path)],
                params,
                n_words=n_words,
                every=every,
                seed=seed,
                n_jobs=n_jobs,
                on_progress=bars.show,
            )
        trained = TrainedSceneModel(model)
        models.save(trained.model, out)
        _show(trained, out, as_json=as_json)
        return
    sequences = [sequence for text in label or [] for sequence in open_labelled(*parse_label(text))]
    images = []
    if csv is not None and has_groups(csv):
        images = read_image_table(csv, camera_file=camera)
    elif csv is not None:
        sequences += read_label_file(csv)
    names = sorted({f"{s.dataset.sequence} ({s.label})" for s in sequences})
    names += [f"{len(images)} images of {csv.name}"] if csv is not None and images else []
    with cluster, Bars(quiet=quiet) as bars:
        trained = train_scene_model(
            [*frames_of(sequences, every=every), *images],
            params,
            trained_on=", ".join(names),
            n_words=n_words,
            levelled=descriptor != "bof" and not of_bags,
            constellation=constellation,
            classifier=classifier,
            grid_search=grid_search,
            check=check,
            n_copies=copies if images else 0,
            start=None if start is None else models.resolve(start),
            seed=seed,
            n_jobs=n_jobs,
            on_progress=bars.show,
        )
    models.save(trained.model, out)
    files = _write_page(trained, out, page) if page is not None else []
    _show(trained, out, as_json=as_json, files=files)


def _check_descriptor(
    descriptor: str | None, classifier: Classifier | None, *, grid_search: bool
) -> None:
    """Refuse a descriptor that no model file holds, or that the classifier does not take."""
    if descriptor not in (None, "levelled", "bof"):
        raise ConfigError(
            f"--descriptor: found {descriptor!r}, expected levelled or bof, which a model file can "
            "hold; evaluate scenes --methods compares others, such as bof-layers:mlp"
        )
    if descriptor == "levelled" and (grid_search or classifier is not None):
        given = "--grid-search" if grid_search else "--classifier"
        raise ConfigError(f"--descriptor levelled: found with {given}, expected bof")
    if grid_search and classifier is not None:
        raise ConfigError(
            f"--grid-search: found with --classifier {classifier}, expected one of the two"
        )


def _write_page(trained: TrainedSceneModel, out: Path, folder: Path) -> list[Path]:
    from slam_bof.visualization import write_comparison

    results = [trained.result] if trained.result is not None else []
    subtitle = f"{trained.n_checked} frames kept from training"
    return write_comparison(folder, results, {}, title=f"Check of {out.name}", subtitle=subtitle)


def _check_out(out: Path) -> None:
    """Refuse a file that cannot be written, before training starts."""
    if out.exists() and not out.is_file():  # the model would replace a device
        found = "a folder" if out.is_dir() else "a device or pipe"
        raise ConfigError(f"{out}: found {found}, expected the name of a file to write")
    out.parent.mkdir(parents=True, exist_ok=True)
    out.with_name(out.name + ".part").touch()
    out.with_name(out.name + ".part").unlink()


def _show(
    trained: TrainedSceneModel, out: Path, *, as_json: bool, files: Sequence[Path] = ()
) -> None:
    from slam_bof.cli.console import print_json, print_table

    scores, svm = trained.scores, trained.svm_params
    figures: dict[str, Any] = {
        "model": str(out),
        "content_sha256": trained.model.content_hash,
        "n_bytes": out.stat().st_size,
        "trained_on": trained.model.trained_on,
        "grid_search": asdict(svm) if svm else None,
        "n_checked": trained.n_checked,
        "files": [str(file) for file in files],
    }
    if scores is not None:
        figures |= {
            "classes": list(scores.classes),
            "accuracy": scores.accuracy,
            "mean_class_accuracy": scores.mean_class_accuracy,
            "calibration_error": scores.calibration_error,
            "by_class": [asdict(of_class) for of_class in scores.by_class],
            "confusion": scores.confusion.tolist(),
        }
    if as_json:
        print_json(figures)
        return
    if svm is not None:
        typer.echo(f"Grid search: {svm}.")
    if scores is not None:
        print_table(
            ("class", "tested", "precision", "recall", "F1"),
            [(c.label, c.n_frames, c.precision, c.recall, c.f1) for c in scores.by_class],
            title=f"Test frames, kept from training: {trained.n_checked}",
        )
        rows = zip(scores.classes, scores.confusion.tolist(), strict=True)
        print_table(
            ("true class", *scores.classes),
            [(name, *counts) for name, counts in rows],
            title="Labelled as",
        )
        typer.echo(
            f"Accuracy {scores.accuracy:.3f}, "
            f"mean-class accuracy {scores.mean_class_accuracy:.3f}, "
            f"expected calibration error {scores.calibration_error:.3f}."
        )
    if files:
        typer.echo(f"Page: {files[0]}; confusion matrix: {files[1]}")
    typer.echo(
        f"Model: {out}, {1e-6 * out.stat().st_size:.2f} MB, hash {trained.model.content_hash[:12]}"
    )
