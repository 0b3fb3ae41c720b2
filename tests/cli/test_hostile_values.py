"""Values on the command line that are no sensible numbers: refused, with exit code 1 or 2."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, get_args, get_origin, get_type_hints

import cv2
import numpy as np
import pytest
import typer
from conftest import CAMERA, box_room_depth_mm
from saved_maps import make_keyframe, save
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.store import MapStore, SessionResult


def float_options(group: typer.Typer, *names: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the path of each command below a group, with each of its options of type float."""
    for info in group.registered_groups:
        yield from float_options(info.typer_instance, *names, info.name)
    for command in group.registered_commands:
        name = command.name or command.callback.__name__
        hints = get_type_hints(command.callback, include_extras=True)
        for parameter, hint in hints.items():
            kind, *more = get_args(hint) if get_origin(hint) is Annotated else (hint,)
            if more and float in (kind, *get_args(kind)):
                declared = more[0].param_decls or (f"--{parameter.replace('_', '-')}",)
                yield (*names, name), declared[0]


FLOATS = sorted(float_options(app))


@pytest.mark.parametrize("value", ["nan", "inf"])
@pytest.mark.parametrize(("names", "option"), FLOATS)
def test_every_number_of_an_option_is_finite(
    names: tuple[str, ...], option: str, value: str
) -> None:
    result = CliRunner().invoke(app, [*names, option, value])
    assert result.exit_code == 2, result.output
    assert option in result.stderr


def test_there_are_such_options() -> None:
    assert len(FLOATS) >= 9


@pytest.mark.parametrize("name", ["run", "train"])
def test_a_seed_that_libraries_do_not_take_is_refused(name: str) -> None:
    assert CliRunner().invoke(app, [name, "--seed", str(2**64)]).exit_code == 2


@pytest.mark.parametrize(
    "text", ["0:99999999999999999999", "\u0663:\u0665", "5:1", "::", "1e3:", "-1:3", "9" * 5000]
)
def test_frames_that_are_none_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "depth").mkdir()
    result = CliRunner().invoke(app, ["run", str(tmp_path), f"--frames={text}"])
    assert result.exit_code == 1
    assert result.exception is None or isinstance(result.exception, SystemExit)


def test_a_map_is_not_merged_with_itself(tmp_path: Path) -> None:
    path = tmp_path / "a.db"
    with MapStore.create(path) as store:
        save(store, make_keyframe(0))
        keyframes = store.keyframes()
        store.finish(0, SessionResult([], [k.T_odom_camera for k in keyframes], [None], []))
    (tmp_path / "link.db").symlink_to(path)
    for other in (path, tmp_path / "link.db"):
        out = str(tmp_path / "out.db")
        result = CliRunner().invoke(app, ["map", "merge", str(path), str(other), "--out", out])
        assert result.exit_code == 1
        assert "found it twice, expected different maps to merge" in result.stderr
    assert not (tmp_path / "out.db").exists()


@pytest.mark.parametrize(
    "command",
    [["query", "keyframes"], ["map", "check"], ["atlas", "add", "atlas"], ["run", "seq", "--map"]],
)
def test_links_in_a_circle_and_odd_names_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("seq").mkdir()
    for number in range(2):
        cv2.imwrite(f"seq/frame-{number:06d}.depth.png", box_room_depth_mm(CAMERA, np.eye(4)))
    file = Path("a\n\x1b[31m\udcff.db")
    file.symlink_to(file)
    result = CliRunner().invoke(app, [*command, str(file)])
    assert result.exit_code == 1, result.output
    line = result.stderr.splitlines()[-1]
    assert line.isprintable()
    assert line.startswith("error: ")
    assert "a \\x1b[31m\\udcff.db: found " in line
    assert file.is_symlink()


def test_a_name_that_is_no_text_is_printed(tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(b"caf\xe9.db")
    MapStore.create(file).close()
    done = subprocess.run(
        [sys.executable, "-m", "slam_bof", "map", "check", file],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONUTF8": "1", "COLUMNS": "500"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "caf\\udce9.db" in done.stdout


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
@pytest.mark.parametrize(
    "command",
    [
        ["run", "seq", "--config"],
        ["run", "seq", "--model"],
        ["run"],
        ["query", "keyframes"],
        ["show", "--out", "page.svg"],
        ["show", "seq", "--out"],
        ["report", "seq", "--out"],
        ["export", "map.db", "--format", "ply", "--out"],
        ["evaluate", "places", "seq", "--curves"],
        ["evaluate", "places", "seq", "--misses"],
    ],
)
def test_a_named_pipe_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.yaml")
    Path("seq").mkdir()
    cv2.imwrite("seq/frame-000000.depth.png", box_room_depth_mm(CAMERA, np.eye(4)))
    result = CliRunner().invoke(app, [*command, "pipe.yaml"])
    assert result.exit_code == 1, result.output
    assert "pipe.yaml" in result.stderr.splitlines()[-1]
