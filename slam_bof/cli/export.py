"""``slam-bof export``: a saved map in the file formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slam_bof.cli.inputs import map_file
from slam_bof.cli.options import COMPONENT, JSON, MAP, finite, out_file
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    from slam_bof.maps import Format

__all__ = ["export"]

FORMATS_OF_SUFFIXES: dict[str, Format] = {
    "": "tum",
    ".txt": "tum",
    ".tum": "tum",
    ".kitti": "kitti",
    ".csv": "csv",
    ".g2o": "g2o",
    ".ply": "ply",
    ".yaml": "occupancy",
    ".yml": "occupancy",
    ".png": "occupancy",
}


def export(
    map_: MAP,
    out: Annotated[Path, typer.Option("--out", "-o", callback=out_file, help="The file to write.")],
    format_: Annotated[
        Literal["tum", "kitti", "csv", "g2o", "ply", "occupancy"] | None,
        typer.Option(
            "--format",
            help="Poses of the keyframes (tum, kitti), poses and labels (csv), the pose graph "
            "(g2o), a point cloud coloured by height (ply), or an occupancy grid for ROS's "
            "map_server (occupancy: YAML, with a PNG beside it). By default by the suffix of "
            "the file: .txt or .tum, .kitti, .csv, .g2o, .ply, .yaml or .png.",
        ),
    ] = None,
    session: Annotated[
        int | None, typer.Option(min=0, help="Export only this session; by default all.")
    ] = None,
    component: COMPONENT = None,
    all_frames: Annotated[
        bool,
        typer.Option("--all-frames", help="For tum and kitti: every frame of the session."),
    ] = False,
    voxel: Annotated[
        float,
        typer.Option(
            min=0.001,
            callback=finite,
            metavar="M",
            help="For ply: one point per voxel of this side.",
        ),
    ] = 0.02,
    z_up: Annotated[
        bool,
        typer.Option("--z-up", help="For ply: in the frame of the occupancy grid, z up, floor 0."),
    ] = False,
    resolution: Annotated[
        float,
        typer.Option(
            min=0.005, callback=finite, metavar="M", help="For occupancy: side of a grid cell."
        ),
    ] = 0.05,
    min_height: Annotated[
        float,
        typer.Option(callback=finite, metavar="M", help="For occupancy: lower points are floor."),
    ] = 0.1,
    max_height: Annotated[
        float,
        typer.Option(
            callback=finite, metavar="M", help="For occupancy: higher points are no obstacles."
        ),
    ] = 2.0,
    as_json: JSON = False,
) -> None:
    """Export a map, at its optimised poses, to a file format of other programs."""
    from slam_bof.cli.console import print_json
    from slam_bof.core import naming
    from slam_bof.maps import OccupancyGridParams, export_map
    from slam_bof.store import MapStore, choose_component, components_of

    format_ = format_ or _format_of(out)
    _refuse_misfits(format_, z_up=z_up, all_frames=all_frames, session=session)
    if min_height >= max_height:
        raise ConfigError(f"--min-height: found {min_height}, expected below {max_height}")
    plan = OccupancyGridParams(
        resolution_m=resolution, min_height_m=min_height, max_height_m=max_height
    )
    if format_ == "occupancy":
        out = _yaml_of(out)
    with MapStore.open(map_file(map_)) as store, store.snapshot(), naming(out):
        inside = choose_component(store, component, session=session)
        if inside.any():
            component = int(components_of(store)[inside][0])
        n = export_map(
            store,
            out,
            format_,
            session=session,
            component=component,
            all_frames=all_frames,
            voxel_size_m=voxel,
            z_up=z_up,
            occupancy=plan,
        )
    n_keyframes = int(inside.sum())
    what = "points" if format_ == "ply" else "frames" if all_frames else "keyframes"
    if as_json:
        answer = {"file": str(out), "format": format_, "n_keyframes": n_keyframes, f"n_{what}": n}
        print_json(answer)
    else:
        typer.echo(f"{n} {what}: {out}")


def _format_of(out: Path) -> Format:
    """Return the format that the suffix of a file says."""
    if out.suffix.lower() not in FORMATS_OF_SUFFIXES:
        known = ", ".join(filter(None, FORMATS_OF_SUFFIXES))
        raise ConfigError(f"--out: found the suffix {out.suffix}, expected {known}, or --format")
    return FORMATS_OF_SUFFIXES[out.suffix.lower()]


def _refuse_misfits(format_: Format, *, z_up: bool, all_frames: bool, session: int | None) -> None:
    """Refuse options that a format has no use for."""
    if z_up and format_ != "ply":
        raise ConfigError(f"--z-up: found with {format_}, expected with ply")
    if all_frames and format_ not in ("tum", "kitti"):
        raise ConfigError(f"--all-frames: found with {format_}, expected with tum or kitti")
    if session is not None and format_ == "g2o":
        raise ConfigError("--session: found with g2o, expected without: a graph has all sessions")


def _yaml_of(out: Path) -> Path:
    """Return the YAML file of an occupancy grid, whose image may have been named instead."""
    if out.suffix == ".png":
        return out.with_suffix(".yaml")
    return out if out.suffix in (".yaml", ".yml") else out.with_name(f"{out.name}.yaml")
