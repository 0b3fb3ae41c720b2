"""``slam-bof evaluate scenes --protocol groups``: labelled images by the room that they show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from slam_bof.cli.scene_results import print_results, result_figures
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    from slam_bof.datasets import LabelledFrame

__all__ = ["GroupOptions", "cross_validate", "score_model"]

METHODS = "ours,profile,words,tokens,profile+tokens,bag:linear,bag:rbf"


@dataclass(frozen=True, slots=True)
class GroupOptions:
    """The options of the command, as the user gave them."""

    csv: Path
    camera: Path | None
    classes: str | None
    methods: str | None
    folds: int
    repeats: int
    copies: int
    share: float
    n_words: int
    seed: int
    n_jobs: int | None

    def frames(self) -> list[LabelledFrame]:
        """Read the table; keep the classes asked for."""
        from slam_bof.datasets import read_image_table

        frames = read_image_table(self.csv, camera_file=self.camera)
        if self.classes is None:
            return frames
        wanted = {name.strip() for name in self.classes.split(",")}
        missing = wanted - {frame.label for frame in frames}
        if missing:
            found = ", ".join(sorted({frame.label for frame in frames}))
            raise ConfigError(
                f"--classes: found no images of {', '.join(sorted(missing))}, "
                f"expected some of {found}"
            )
        return [frame for frame in frames if frame.label in wanted]


def cross_validate(options: GroupOptions, out: Path | None, *, as_json: bool, quiet: bool) -> None:
    """Train on some rooms and test on others, and print or write how every method did."""
    from slam_bof.cli.console import Bars, print_json
    from slam_bof.evaluation import cross_validate_groups
    from slam_bof.visualization import write_comparison

    frames = options.frames()
    with Bars(quiet=quiet) as bars:
        results = cross_validate_groups(
            frames,
            [name.strip() for name in (options.methods or METHODS).split(",")],
            n_folds=options.folds,
            n_repeats=options.repeats,
            n_copies=options.copies,
            share=options.share,
            n_words=options.n_words,
            seed=options.seed,
            n_jobs=options.n_jobs,
            on_progress=bars.show,
        )
    n_groups = len({frame.group for frame in frames})
    title = f"groups: {len(frames)} images of {n_groups} groups, {options.folds} folds"
    title += f", {options.repeats} times"
    files = []
    if out is not None:
        files = write_comparison(out, results, {}, title="Scene labels, groups", subtitle=title)
    if as_json:
        figures = {"protocol": "groups", "n_images": len(frames), "n_groups": n_groups}
        classes = list(results[0].scores.classes)
        methods = {result.method: result_figures(result) for result in results}
        print_json(
            figures
            | {"classes": classes, "methods": methods, "files": [str(file) for file in files]}
        )
    else:
        print_results(title, results, {}, files)


def score_model(options: GroupOptions, name: str, *, as_json: bool, quiet: bool) -> None:
    """Label all images with a model, and print how often it is right, and how sure when wrong."""
    from slam_bof.cli.console import Bars, print_json, print_table
    from slam_bof.evaluation import evaluate_labeller
    from slam_bof.scenes import model as models

    model, frames = models.resolve(name), options.frames()
    with Bars(quiet=quiet) as bars:
        figures = evaluate_labeller(model, frames, on_progress=bars.show)
    if as_json:
        print_json(figures)
        return
    by_class = figures.pop("by_class")
    print_table(
        ("", ""),
        [(key, value) for key, value in figures.items()],
        title=f"{name}: {len(frames)} images of {options.csv}",
    )
    print_table(
        ("scene", "images", "right", "unknown", "wrong above 0.6"),
        [tuple(row.values()) for row in by_class],
    )
    typer.echo("A scene that the model does not know is right when it is unknown.")
