"""``slam-bof show``: pictures of what the method sees in a frame, or finds between two."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam_bof.cli.inputs import open_sequence, read_image
from slam_bof.cli.options import DATASET, DEPTH_SCALE, INTRINSICS, QUIET, SOURCE, out_file
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    from slam_bof.bof import Constellation
    from slam_bof.types import DepthFrame

__all__ = ["show"]


def show(
    source: SOURCE,
    out: Annotated[
        Path, typer.Option("--out", "-o", callback=out_file, help="The SVG file to write.")
    ],
    frame: Annotated[int, typer.Option(min=0, help="Number of the frame of a SEQUENCE.")] = 0,
    match: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|IMAGE",
            help="Another frame of the SEQUENCE, or another image: the picture then shows the BOF "
            "constellations of both and what corresponds.",
        ),
    ] = None,
    layers: Annotated[int, typer.Option(min=1, max=60, help="Layers of the point cloud.")] = 20,
    dataset: DATASET = "auto",
    intrinsics: INTRINSICS = None,
    depth_scale: DEPTH_SCALE = None,
    quiet: QUIET = False,
) -> None:
    """Draw the cloud, layers, contours and BOFs of a frame, or the constellations of two frames."""
    from slam_bof.datasets import is_image
    from slam_bof.slam import PluginChoice

    if out.suffix != ".svg":
        raise ConfigError(f"--out {out}: found {out.suffix or 'no suffix'}, expected .svg")
    if source.is_file() and is_image(source):
        names = [source, *([Path(match)] if match is not None else [])]
        frames = [
            read_image(path, None, intrinsics=intrinsics, depth_scale=depth_scale)[0]
            for path in names
        ]
    else:
        if match is not None and not match.isdigit():
            raise ConfigError(f"--match {match}: expected the number of a frame of {source}")
        sequence, _ = open_sequence(source, PluginChoice(name=dataset), None, quiet=quiet)
        numbers = [frame, *([int(match)] if match is not None else [])]
        if max(numbers) >= len(sequence):
            raise ConfigError(
                f"{source}: found {len(sequence)} frames, expected number {max(numbers)} too"
            )
        names = [Path(f"frame {number}") for number in numbers]
        frames = [sequence.frame(number) for number in numbers]
    labels = [path.name for path in names]
    drawn = _draw_one(frames[0], labels[0], layers) if match is None else _draw_two(frames, labels)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(drawn, encoding="utf-8")
    if not quiet:
        typer.echo(f"{out}")


def _draw_one(frame: DepthFrame, name: str, n_layers: int) -> str:
    from slam_bof.bof import LayerParams, PlaceParams
    from slam_bof.visualization import draw_bof

    params = PlaceParams(layers=LayerParams(n_layers=n_layers))
    return draw_bof(frame, params, title=f"The BOF of {name}")


def _draw_two(frames: list[DepthFrame], names: list[str]) -> str:
    from slam_bof.bof import match_constellations
    from slam_bof.visualization import draw_constellations

    query, match = map(_constellation, frames)
    best = next(iter(match_constellations(query, match)), None)
    title = f"The BOF constellations of {names[0]} and {names[1]}"
    return draw_constellations(query, match, best, title=title, names=(names[0], names[1]))


def _constellation(frame: DepthFrame) -> Constellation:
    """Describe a frame by itself: the camera is held about upright."""
    import numpy as np

    from slam_bof.bof import describe_constellation
    from slam_bof.geometry import GravityTracker, make_view

    gravity = GravityTracker(never_lost=True)
    return describe_constellation(
        frame, gravity.update(make_view(frame).known_normals(), np.eye(4))
    )
