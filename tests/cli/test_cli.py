"""The command line as its user meets it: answers of a run and of what it leaves."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from commands import N_FRAMES, refusal, slam_bof, write_box_sequence, write_tiny_model
from conftest import CAMERA
from rrd import read_rrd
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.geometry import se3
from slam_bof.store import MapStore


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_box_sequence(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_model(tmp_path_factory.mktemp("model") / "tiny.bof")


@pytest.fixture(scope="module")
def finished(room: Path, model_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run over the box room."""
    out = tmp_path_factory.mktemp("runs")
    every = ("--set", "keyframes.policy=every", "--set", "keyframes.every=2")
    result = slam_bof("run", room, "--out", out, "--model", model_file, *every, "--json", "--quiet")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    said = json.loads(result.stdout)
    assert said["n_frames"] == N_FRAMES
    assert said["sequence"] == "box/seq-01"
    assert said["folder"] == str((out / "latest").resolve())
    return Path(said["folder"])


# What a run leaves, asked by the other commands


def test_run_prints_a_table_and_says_where_the_files_are(
    room: Path, model_file: Path, tmp_path: Path
) -> None:
    result = slam_bof("run", room, "-o", tmp_path, "--model", model_file, "--max-frames", 3)
    assert result.exit_code == 0, result.output
    assert "ATE with loops" in result.stdout
    for kind in ("single image", "smoothed"):  # which label is counted
        assert f"Correct scene labels ({kind})" in result.stdout
    assert f"Files: {(tmp_path / 'latest').resolve()}" in result.stdout
    assert "box/seq-01: 3/3" in result.stderr, "progress without a terminal"


def test_a_run_is_recorded_for_the_viewer_with_the_map_at_its_end(
    room: Path, model_file: Path, tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="needs rerun: pip install slam-bof[view]")
    file = tmp_path / "run.rrd"
    every = ("--set", "keyframes.policy=every", "--set", "keyframes.every=2")
    result = slam_bof(
        "run", room, "-o", tmp_path, "--model", model_file, *every, "--view", file, "--quiet"
    )
    assert result.exit_code == 0, result.output
    rows = read_rrd(file)
    with MapStore.open(tmp_path / "latest" / "map.db") as store:
        at = store.map_poses()[:, :3, 3]
    (finished,) = rows["/map/keyframes"]
    np.testing.assert_allclose(finished["Points3D:positions"], at, atol=1e-6)
    for k in range(1, len(at)):
        (way,) = rows[f"/map/corrected/{k}"][0]["LineStrips3D:strips"]
        np.testing.assert_allclose(way[-1], at[k], atol=1e-6)
    assert len(rows["/time/frame_ms"]) == N_FRAMES


@pytest.mark.parametrize("options", [[], ["--color"]])
def test_colour_of_the_data_set_is_kept_if_asked(
    room: Path, model_file: Path, tmp_path: Path, options: list[str]
) -> None:
    sequence = tmp_path / "box" / "seq-01"
    sequence.mkdir(parents=True)
    for file in sorted(room.glob("frame-*"))[:4]:
        shutil.copy(file, sequence)
    for depth in sequence.glob("*.depth.png"):
        color = np.full((CAMERA.height, CAMERA.width, 3), 200, np.uint8)
        cv2.imwrite(str(depth).replace("depth", "color"), color)
    arguments = ["-o", tmp_path, "--model", model_file, "--quiet", *options]
    assert slam_bof("run", sequence, *arguments).exit_code == 0
    header = (tmp_path / "latest" / "map.ply").read_bytes()[:400]
    assert (b"property uchar red" in header) == bool(options)


def test_options_outrank_the_configuration(
    room: Path, model_file: Path, finished: Path, tmp_path: Path
) -> None:
    written = yaml.safe_load((finished / "config.yaml").read_text())
    assert written["model"] == str(model_file)
    assert written["keyframes"]["every"] == 2
    result = slam_bof(
        "run", room, "-o", tmp_path, "-c", finished / "config.yaml", "--seed", 5, "--quiet"
    )
    assert result.exit_code == 0, result.output
    again = yaml.safe_load((tmp_path / "latest" / "config.yaml").read_text())
    assert again == {**written, "seed": 5}


def test_a_map_tells_the_camera_and_the_unit_of_an_image(
    finished: Path, room: Path, tmp_path: Path
) -> None:
    image = tmp_path / "image.png"
    depth = cv2.imread(str(room / "frame-000002.depth.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(image), depth)
    answer = json.loads(slam_bof("query", image, "--map", finished, "--json").stdout)
    assert answer["intrinsics_from"] == f"from {finished / 'map.db'}"
    assert answer["intrinsics"]["width"] == CAMERA.width

    def localized(map_: Path, *more: object) -> str:
        """Why a plain box is not localised, without figures, which are rounding errors."""
        row = json.loads(slam_bof("localize", map_, image, *more, "--json").stdout)
        return re.sub(r"-?[\d.]+", "", row["reason"])

    known = localized(finished)

    # The same depth in fifths of a millimetre, and a map of such images.
    in_fifths = tmp_path / "fifths.db"
    shutil.copy(finished / "map.db", in_fifths)
    with MapStore.open(in_fifths, read_only=False) as store:
        store.set_parameters({"units_per_m": 5000.0})
    cv2.imwrite(str(image), 5 * depth)
    assert localized(finished) != known
    assert localized(in_fifths) == known
    with MapStore.open(in_fifths, read_only=False) as store:
        store.set_parameters({"units_per_m": None})
    assert "found no unit of depth in" in refusal("localize", in_fifths, image)
    assert localized(in_fifths, "--depth-scale", 5000) == known


def test_a_slice_keeps_the_numbers_of_its_frames(
    room: Path, model_file: Path, tmp_path: Path
) -> None:
    sequence = tmp_path / "seq-01"
    shutil.copytree(room, sequence)
    file = sequence / "frame-000004.depth.png"
    file.write_bytes(file.read_bytes()[:300])
    options = ("--model", model_file, "--frames", "2:6", "-o", tmp_path / "runs", "--quiet")
    assert slam_bof("run", sequence, *options).exit_code == 0
    found = json.loads(slam_bof("query", tmp_path / "runs" / "latest", "--json").stdout)
    assert found[0]["frame_index"] == 2
    assert "frame 4 skipped" in (tmp_path / "runs" / "latest" / "run.log").read_text()
    slam_bof("export", tmp_path / "runs" / "latest", "-o", tmp_path / "labels.csv")
    assert (tmp_path / "labels.csv").read_text().splitlines()[1].split(",")[:2] == ["0", "2"]
    located = slam_bof(
        "localize", tmp_path / "runs" / "latest", sequence, "--frames", "3:6", "--json"
    )
    assert [row["frame_index"] for row in json.loads(located.stdout)] == [3, 4, 5]


def test_a_run_is_resumed_by_its_folder_alone(room: Path, model_file: Path, tmp_path: Path) -> None:
    sequence = tmp_path / "seq-01"
    shutil.copytree(room, sequence)
    options = ("--model", model_file, "--frames", "1:6", "-o", tmp_path / "runs", "--quiet")
    assert slam_bof("run", sequence, *options).exit_code == 0
    folder = (tmp_path / "runs" / "latest").resolve()
    again = slam_bof("run", "--resume", folder, "--quiet", "--json")
    assert again.exit_code == 0, again.output
    assert json.loads(again.stdout)["folder"] == str(folder)
    sequence.rename(tmp_path / "elsewhere")
    assert f"at {sequence}, expected the sequence: slam-bof run SEQUENCE --resume FOLDER" in (
        refusal("run", "--resume", folder, "--quiet")
    )
    assert slam_bof("run").exit_code == 2


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("poses.txt", "tum"),
        ("poses.kitti", "kitti"),
        ("labels.csv", "csv"),
        ("graph.g2o", "g2o"),
        ("cloud.ply", "ply"),
        ("poses", "tum"),
    ],
)
def test_the_suffix_says_what_is_exported(
    finished: Path, tmp_path: Path, name: str, expected: str
) -> None:
    out = slam_bof("export", finished, "-o", tmp_path / name, "--json")
    assert json.loads(out.stdout)["format"] == expected
    assert (tmp_path / name).exists()


def test_a_plan_has_its_picture_beside_it(finished: Path, tmp_path: Path) -> None:
    assert slam_bof("export", finished, "-o", tmp_path / "plan.png").exit_code == 0
    assert {file.name for file in tmp_path.iterdir()} == {"plan.png", "plan.yaml"}
    plan = yaml.safe_load((tmp_path / "plan.yaml").read_text())
    assert plan["image"] == "plan.png"
    T_plan_map = np.array(plan["T_plan_map"])
    se3.check_rigid(T_plan_map)
    np.testing.assert_allclose(T_plan_map[:3, :3] @ [0, 1, 0], [0, 0, -1], atol=0.05)
    assert "suffix .pdf, expected .txt" in refusal("export", finished, "-o", tmp_path / "a.pdf")
    assert "--z-up: found with tum" in refusal(
        "export", finished, "-o", tmp_path / "a.txt", "--z-up"
    )


def test_clouds_can_stand_upright(
    finished: Path, room: Path, model_file: Path, tmp_path: Path
) -> None:
    """The box room is 3 m high; its floor and ceiling are seen in part."""
    from slam_bof.core import import_open3d

    def heights(path: Path, axis: int) -> np.ndarray:
        return np.asarray(import_open3d().io.read_point_cloud(str(path)).points)[:, axis]

    every = ("--set", "keyframes.policy=every", "--set", "keyframes.every=2")  # as in finished
    options = ("--model", model_file, "-o", tmp_path / "runs", "--quiet", "--z-up", *every)
    assert slam_bof("run", room, *options).exit_code == 0
    assert slam_bof("export", finished, "-o", tmp_path / "up.ply", "--z-up").exit_code == 0
    slam_bof("export", finished, "-o", tmp_path / "map.ply")
    down_m = heights(tmp_path / "map.ply", 1)
    for path in (tmp_path / "up.ply", tmp_path / "runs" / "latest" / "map.ply"):
        assert np.ptp(heights(path, 2)) == pytest.approx(np.ptp(down_m), abs=0.1)


def test_shells_can_complete_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "--install-completion" in slam_bof("--help").stdout
    monkeypatch.setenv("_SLAM_BOF_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "slam-bof lo")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert "localize" in CliRunner().invoke(app, [], prog_name="slam-bof").output


def test_query_answers_in_tables_and_json(finished: Path) -> None:
    result = slam_bof("query", finished, "--json")
    found = json.loads(result.stdout)
    assert [record["id"] for record in found] == [0, 1, 2]
    assert [record["frame_index"] for record in found] == [0, 2, 4]
    assert len(json.loads(slam_bof("query", finished, "--limit", 1, "--json").stdout)) == 1
    (nearest,) = json.loads(
        slam_bof("query", finished / "map.db", "--time", 0.07, "--limit", 1, "--json").stdout
    )
    assert nearest["id"] == 1
    place = ",".join(map(str, found[2]["translation_m"]))
    (nearest,) = json.loads(
        slam_bof("query", finished, "--near", place, "--limit", 1, "--json").stdout
    )
    assert (nearest["id"], nearest["distance_m"]) == (2, 0.0)
    table = slam_bof("query", finished)
    assert table.exit_code == 0
    assert len([line for line in table.stdout.splitlines() if "│" in line]) == 3
    assert json.loads(slam_bof("query", "loops", finished, "--accepted", "--json").stdout) == []


def test_query_explains_mistakes(finished: Path, tmp_path: Path) -> None:
    assert "found no keyframe 77, expected 0 to 2" in refusal("query", finished, "--keyframe", 77)
    assert "found no scene 'moon'" in refusal("query", finished, "--scene", "moon")
    assert "--near: found '1,2', expected X Y Z" in refusal("query", finished, "--near", "1,2")
    assert "--near: found '1,2', expected X Y Z" in refusal("query", finished, "--near", 1, 2)
    assert "--near: found '1,nan,2', expected" in refusal("query", finished, "--near", "1,nan,2")
    assert slam_bof("query", finished, "--model", "m").exit_code == 2
    assert "--near: found 'here', expected" in refusal("query", finished, "--near", "here")
    assert "expected a map.db" in refusal("query", tmp_path)
    (tmp_path / "map.db").write_text("not a database, but long enough to look at" * 20)
    assert "map.db: found no SQLite database" in refusal("query", tmp_path)


def test_report_is_written_again(finished: Path, tmp_path: Path) -> None:
    page = tmp_path / "again.html"
    result = slam_bof("report", finished, "--out", page, "--json")
    assert json.loads(result.stdout) == {"report": str(page)}
    assert "<html" in page.read_text(encoding="utf-8")[:500].lower()
    assert "found no metrics.json there, expected the folder of a finished run" in refusal(
        "report", tmp_path
    )
    assert "found no such folder" in refusal("report", tmp_path / "none")
    assert "again.html/x.html: " in refusal("report", finished, "-o", page / "x.html")


@pytest.mark.parametrize(("kind", "columns"), [("tum", 8), ("kitti", 12)])
def test_export_writes_poses(finished: Path, tmp_path: Path, kind: str, columns: int) -> None:
    file = tmp_path / "poses.txt"
    result = slam_bof("export", finished, "-o", file, "--format", kind, "--json")
    assert json.loads(result.stdout) == {"file": str(file), "format": kind, "n_keyframes": 3}
    assert np.loadtxt(file).shape == (3, columns)


def test_export_writes_labels(finished: Path, tmp_path: Path) -> None:
    file = tmp_path / "labels.csv"
    assert slam_bof("export", finished, "-o", file, "--format", "csv").exit_code == 0
    header, *rows = file.read_text().splitlines()
    assert header.startswith("id,frame_index,stamp_s,scene,probability,tx,")
    assert [row.split(",")[1] for row in rows] == ["0", "2", "4"]
