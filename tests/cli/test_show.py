"""Pictures of the method, drawn by the command."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof.bof import PlaceParams, descriptors
from slam_bof.cli import app
from slam_bof.core import registry


@pytest.fixture(scope="module")
def turn(tmp_path_factory: pytest.TempPathFactory, write_turn) -> Path:
    folder = tmp_path_factory.mktemp("show") / "room" / "seq-01"
    write_turn(folder, [0.0, 0.05, 2.0])
    return folder


def show(*arguments: object):
    return CliRunner().invoke(app, ["show", *map(str, arguments)])


def texts(file: Path) -> list[str]:
    root = ElementTree.fromstring(file.read_text("utf-8"))
    return [element.text or "" for element in root if element.tag.endswith("text")]


def test_the_bofs_of_a_frame_are_drawn(turn: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "frame.svg"
    result = show(turn, "--frame", 1, "--out", out)
    assert result.exit_code == 0, result.output
    n = len(descriptors(registry.open_dataset(turn).frame(1), PlaceParams()))
    assert f"BOF: {n} curves of 180 values" in texts(out)
    first = out.read_bytes()
    assert show(turn, "--frame", 1, "--out", out, "--quiet").exit_code == 0
    assert out.read_bytes() == first
    few = tmp_path / "few.svg"
    assert show(turn, "--frame", 1, "--layers", 3, "-o", few, "-q").exit_code == 0
    assert any("in 3 layers" in text for text in texts(few))


def test_what_corresponds_in_two_frames_is_drawn(turn: Path, tmp_path: Path) -> None:
    out = tmp_path / "pair.svg"
    assert show(turn, "--frame", 1, "--match", 0, "-o", out, "-q").exit_code == 0
    (agree,) = (text for text in texts(out) if "pairs agree" in text)
    # The camera turned by 3 degrees on the spot, in a room with little in it.
    n_pairs, _, _, distance_m, _, angle_deg, *_ = agree.split()
    assert int(n_pairs) > 10
    assert float(distance_m) < 0.3
    assert int(angle_deg) < 10
    assert show(turn, "--frame", 1, "--match", 2, "-o", out, "-q").exit_code == 0


def test_images_are_drawn_as_well_and_mistakes_named(turn: Path, tmp_path: Path) -> None:
    first, second, _ = sorted(turn.glob("*.depth.png"))
    out = tmp_path / "image.svg"
    camera = ("--intrinsics", 585, 585, 320, 240, "--depth-scale", 1000)
    assert show(first, "--match", second, *camera, "-o", out, "-q").exit_code == 0
    assert any("pairs agree" in text for text in texts(out))
    dark = tmp_path / "dark.png"
    cv2.imwrite(str(dark), np.zeros((480, 640), np.uint16))
    assert show(dark, *camera, "-o", out, "-q").exit_code == 0
    assert "BOF: 0 curves of 180 values" in texts(out)
    assert show(first, "--match", dark, *camera, "-o", out, "-q").exit_code == 0
    assert "No contours correspond" in texts(out)
    for arguments, message in (
        ((turn, "-o", tmp_path / "x.png"), "found .png, expected .svg"),
        ((turn, "--frame", 3, "-o", out), "found 3 frames, expected number 3"),
        ((turn, "--match", "door", "-o", out), "--match door: expected the number of a frame"),
        ((first, "-o", out), "found no intrinsics.json beside it"),
    ):
        result = show(*arguments)
        assert result.exit_code == 1
        assert message in result.stderr
