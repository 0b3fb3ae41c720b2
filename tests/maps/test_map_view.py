"""What the viewer is given of a saved map, read back from the file that it is recorded in."""

import sys

import numpy as np
import pytest
from rrd import read_rrd
from saved_maps import CAMERA, make_candidate, make_keyframe, make_loop, make_subsampled, save
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.geometry import se3
from slam_bof.maps import show_finished_map
from slam_bof.scenes import MapRoom
from slam_bof.store import MapStore, SessionResult
from slam_bof.visualization import RerunRecording

ROOM = MapRoom(0, "bathroom", 0.9, (0, 1, 2), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (2.0, 0.5, 0.0))


@pytest.fixture
def folder(tmp_path):
    """The folder of a map: keyframes 1 m apart, of which 0 to 3 and 4 to 5 are components."""
    pairs = {
        2: [make_candidate(2, 1, decision="rejected", reason="overlap 0.31, expected 0.5")],
        3: [make_candidate(3, 1), make_candidate(3, 2, kind="covisibility")],
        4: [make_candidate(4, 0, decision="held", reason="no other loop agrees")],
    }
    loops = {3: [make_loop(3, 1), make_loop(3, 2, "covisibility")]}
    segments = [0, 0, 0, 1, 2, 2]
    with MapStore.create(tmp_path / "map.db") as store:
        for k, segment in enumerate(segments):
            keyframe = make_keyframe(k)
            object.__setattr__(keyframe, "segment", segment)
            save(store, keyframe, pairs.get(k, []), loops.get(k, []))
        poses = np.array([se3.pose(np.eye(3), [float(k), 0.0, 0.0]) for k in range(6)])
        smoothed = [store.keyframes()[k].scene for k in range(6)]
        store.finish(0, SessionResult([], poses, smoothed, [ROOM]))
    return tmp_path


@pytest.fixture
def rows(folder):
    """What is recorded of the map by the command."""
    pytest.importorskip("rerun", reason="needs rerun: pip install slam-bof[view]")
    file = folder / "map.rrd"
    result = view(folder, "--out", file)
    assert result.exit_code == 0, result.output
    assert result.stdout == f"6 keyframes: {file}\n"
    return read_rrd(file)


def view(*arguments):
    return CliRunner().invoke(app, ["view", *map(str, arguments)])


def values(rows, entity, column):
    return {row["keyframe"]: np.squeeze(row[column]).tolist() for row in rows[entity]}


def test_each_keyframe_is_at_its_place_in_the_space_of_its_component(rows):
    at = values(rows, "/map/camera", "Transform3D:translation")
    assert at == {k: [float(k), 0.0, 0.0] for k in range(4)}
    at = values(rows, "/component_2/camera", "Transform3D:translation")
    assert at == {k: [float(k), 0.0, 0.0] for k in (4, 5)}
    for name in ("path", "odometry"):
        (row,) = rows[f"/map/{name}/2"]
        (way,) = row["LineStrips3D:strips"]
        assert len(way) == 5, "four frames from keyframe 1 on"
    np.testing.assert_allclose(
        rows["/map/path/2"][0]["LineStrips3D:strips"][0][-1], [2, 0, 0], atol=1e-6
    )
    # By odometry the first keyframe of a segment is where the map has it, and the others follow.
    (first,), (second,) = (rows[f"/component_2/odometry/{k}"] for k in (4, 5))
    np.testing.assert_allclose(first["LineStrips3D:strips"], [[[4, 0, 0]]], atol=1e-6)
    T_4_5 = se3.inverse(make_keyframe(4).T_odom_camera) @ make_keyframe(5).T_odom_camera
    expected = T_4_5[:3, 3] + [4, 0, 0]
    np.testing.assert_allclose(second["LineStrips3D:strips"][0][-1], expected, atol=1e-6)


def test_depth_and_points_are_those_that_the_map_has(rows):
    depths = [row for row in rows["/map/camera/depth"] if row.get("DepthImage:buffer")]
    assert [row["keyframe"] for row in depths] == [0, 1, 2, 3]
    (data,) = depths[2]["DepthImage:buffer"]
    depth_mm = make_subsampled(2).depth
    found_mm = np.frombuffer(bytes(data), np.uint16).reshape(depth_mm.shape)
    np.testing.assert_array_equal(found_mm, depth_mm)
    points = np.array(rows["/map/points/2"][0]["Points3D:positions"])
    voxels = np.concatenate(
        [
            np.floor(np.array(rows[f"/map/points/{k}"][0]["Points3D:positions"]) / 0.03)
            for k in (0, 1, 2)
        ]
    )
    assert len(np.unique(voxels, axis=0)) > 0.99 * len(voxels), "float32 rounds a few over"
    assert 0.5 * depth_mm.size < len(points) <= depth_mm.size
    u = CAMERA.fx * (points[:, 0] - 2.0) / points[:, 2] + CAMERA.cx
    np.testing.assert_allclose(np.unique(u.round(2)), np.arange(CAMERA.width), atol=0.02)


def test_points_have_the_colour_of_their_room(rows):
    colors = {
        k: rows[f"/{space}/points/{k}"][0]["Points3D:colors"]
        for space, ids in (("map", range(4)), ("component_2", (4, 5)))
        for k in ids
    }
    (box,) = rows["/map/rooms/0"]
    assert box["Boxes3D:labels"] == ["bathroom 0, probability 0.90"]
    assert colors[0] == colors[1] == colors[2] == box["Boxes3D:colors"]
    assert colors[3] == colors[5], "both are of an office"
    assert len({tuple(colors[k]) for k in (0, 3, 4)}) == 3
    whole, other = (rows[f"/{space}/keyframes"][0] for space in ("map", "component_2"))
    assert whole["Points3D:colors"] != other["Points3D:colors"]
    assert other["Points3D:labels"] == ["keyframe 4, component 2", "keyframe 5, component 2"]


def test_a_recorded_run_gets_the_corrected_path_and_the_rooms_at_its_end(folder, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun: pip install slam-bof[view]")
    file = tmp_path / "run.rrd"
    with MapStore.open(folder / "map.db") as store, RerunRecording("room", str(file)) as recording:
        recording.set_time("frame", 23)
        show_finished_map(store, recording)
    rows = read_rrd(file)
    for space, ids in (("map", range(1, 4)), ("component_2", (4, 5))):
        for k in ids:
            (row,) = rows[f"/{space}/corrected/{k}"]
            assert "frame" not in row, "at all times"
            (way,) = row["LineStrips3D:strips"]
            np.testing.assert_allclose(way[-1], [k, 0, 0], atol=1e-6)
    assert rows["/map/rooms/0"][0]["Boxes3D:labels"] == ["bathroom 0, probability 0.90"]
    assert len(rows["/map/keyframes"][0]["Points3D:positions"]) == 4


def test_loops_and_refused_pairs_are_shown_with_the_reason(rows):
    assert [entity for entity in rows if "/loops/" in entity] == ["/map/loops/3-1"]
    (loop,) = rows["/map/loops/3-1"]
    assert loop["LineStrips3D:strips"] == [[[3, 0, 0], [1, 0, 0]]]
    refused = {row["keyframe"]: row for row in rows["/map/refused"]}
    assert refused[2]["LineStrips3D:strips"] == [[[2, 0, 0], [1, 0, 0]]]
    assert refused[2]["LineStrips3D:labels"] == ["rejected: overlap 0.31, expected 0.5"]
    assert refused[3]["LineStrips3D:strips"] == [], "those of keyframe 2 vanish"
    # Between components there is no line to draw, but the reason stays.
    assert all(row["LineStrips3D:strips"] == [] for row in rows["/component_2/refused"])
    told = {row["keyframe"]: row["TextLog:text"] for row in rows["/loops"]}
    assert told[4] == ["4 with 0: held: no other loop agrees"]
    pages = values(rows, "/keyframe", "TextDocument:text")
    assert "| 1 | bag | rejected | 0.70 | overlap 0.31, expected 0.5 |" in pages[2]
    assert "| frame | 8 of room/seq-01, 0.267 s |" in pages[2]
    assert "| room | bathroom 0 |" in pages[2]
    assert "| room | none |" in pages[4]


def test_mistakes_are_one_line_and_leave_no_file(folder, tmp_path, monkeypatch):
    file = tmp_path / "new.rrd"
    with MapStore.create(tmp_path / "open.db") as store:
        save(store, make_keyframe(0))
    MapStore.create(tmp_path / "empty.db").close()
    for source, out, message in (
        (folder, tmp_path / "new.txt", "found .txt, expected .rrd"),
        (tmp_path / "open.db", file, "found an interrupted run without optimised poses"),
        (tmp_path / "empty.db", file, "found no keyframes, expected at least one"),
        (tmp_path / "none", file, "none"),
    ):
        result = view(source, "--out", out)
        assert (result.exit_code, result.stdout) == (1, "")
        assert message in result.stderr
        assert len(result.stderr.splitlines()) == 1
    monkeypatch.setitem(sys.modules, "rerun", None)
    result = view(folder, "--out", file)
    assert result.exit_code == 1
    assert result.stderr == (
        "error: found no rerun, expected it installed: pip install 'slam-bof[view]'\n"
    )
    assert not file.exists()
