"""``slam-bof localize``: the poses of depth images in a saved map."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import typer

from slam_bof.cli.answers import pose_values, show_answer, show_answers
from slam_bof.cli.inputs import map_file, open_sequence, read_image
from slam_bof.cli.options import (
    COMPONENT,
    DATASET,
    DEPTH_SCALE,
    EVERY,
    FORMAT,
    FRAMES,
    INTRINSICS,
    JSON,
    MAP,
    QUIET,
    SOURCE,
    Format,
)

if TYPE_CHECKING:
    from slam_bof.maps import MapLocalizer
    from slam_bof.types import DepthFrame, Trajectory

__all__ = ["localize"]

COLUMNS = (
    ("frame", "frame_index"),
    ("x m", "translation_m_0"),
    ("y m", "translation_m_1"),
    ("z m", "translation_m_2"),
    ("component", "component"),
    ("keyframe", "keyframe_id"),
    ("overlap", "overlap"),
    ("room", "room"),
    ("scene", "scene"),
    ("probability", "scene_probability"),
    ("why unknown", "reason"),
)


def localize(
    map_: MAP,
    source: SOURCE,
    every: EVERY = 1,
    frames: FRAMES = None,
    dataset: DATASET = "auto",
    component: COMPONENT = None,
    intrinsics: INTRINSICS = None,
    depth_scale: DEPTH_SCALE = None,
    format_: FORMAT = "table",
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Localize depth images in a map, each by itself.

    Prints T_map_camera, the matching keyframe, the label of the room it is in, and the scene label
    of the image, or why the pose is unknown. For a sequence with true poses, the table ends with
    the accuracy of the answers.
    """
    from slam_bof.datasets import first_frame, is_image
    from slam_bof.maps import MapLocalizer
    from slam_bof.slam import PluginChoice

    form: Format = "json" if as_json else format_
    answer = partial(_answer, MapLocalizer.open(map_file(map_), component=component))
    if is_image(source) and not source.is_dir():
        frame, _ = read_image(source, map_, intrinsics=intrinsics, depth_scale=depth_scale)
        show_answer(frame, answer, COLUMNS, form)
        return
    sequence, _ = open_sequence(source, PluginChoice(name=dataset), frames, quiet=True)
    rows = show_answers(sequence, answer, COLUMNS, form, every=every, quiet=quiet)
    truth = sequence.groundtruth()
    if form == "table" and truth is not None:
        _show_accuracy(rows, truth, first_frame(sequence))


def _answer(localizer: MapLocalizer, frame: DepthFrame) -> dict[str, Any]:
    """Localize a frame; return the answer as a row."""
    located = localizer.localize(frame)
    found, scene = located.localization, located.scene
    return {
        "stamp_s": frame.stamp_s,
        "is_known": found.is_known,
        **pose_values(found.T_map_camera),
        "component": localizer.component if found.is_known else None,
        "keyframe_id": None if located.keyframe is None else located.keyframe.id,
        "overlap": found.overlap if found.is_known else None,
        "rmse_m": found.rmse_m if found.is_known else None,
        "room": located.room,
        "scene": None if scene is None else scene.label,
        "scene_probability": None if scene is None else scene.probability,
        "reason": found.reason,
    }


def _show_accuracy(rows: list[dict[str, Any]], truth: Trajectory, first: int) -> None:
    """Print how accurately frames were localized; the true poses begin with frame ``first``."""
    import numpy as np

    from slam_bof.evaluation import pose_accuracy

    unknown = np.full((4, 4), np.nan)
    found = np.array([row.get("T_map_camera") or unknown for row in rows])
    accuracy = pose_accuracy(found, truth.poses[[row["frame_index"] - first for row in rows]])
    if accuracy is None:
        return
    shares = ", ".join(
        f"{share:.1%} within {metres:g} m and {degrees:g} degrees"
        for (metres, degrees), share in accuracy.within.items()
    )
    typer.echo(
        f"{shares} of the true poses; median error {accuracy.median_m:.3f} m, "
        f"{accuracy.median_deg:.2f} degrees (after aligning the map with the true poses)"
    )
