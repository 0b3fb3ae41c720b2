"""Localisation in an atlas of two flats, and its command line."""

import json
from functools import lru_cache

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof.atlas import Atlas, AtlasLocalizer, describe_map
from slam_bof.cli import app
from slam_bof.geometry import se3
from slam_bof.maps import MapSession
from slam_bof.slam import preset
from slam_bof.slam.config import override
from slam_bof.synthetic.rooms import make_room
from slam_bof.synthetic.scene import Scene3D
from slam_bof.types import DepthFrame, Intrinsics

CONFIG = override(preset("indoor"), ["keyframes.max_gap=4", "model=synthetic"])
N_FRAMES = 14
CAMERA = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)
OTHER = Intrinsics(128, 96, 92.0, 92.0, 63.5, 47.5)


def pose(yaw, x, y):
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.eye(4)
    T[:3] = [[s, 0, c, x], [-c, 0, s, y], [0, -1, 0, 1.3]]
    return T


@pytest.fixture(scope="module")
def scenes():
    """Two rooms that are furnished in different ways."""
    return [make_room("living_room", seed=3), make_room("kitchen", seed=8)]


@lru_cache(maxsize=8)
def scene_of(room, camera):
    return Scene3D(room.mesh, camera)


def look(room, T, k=0, camera=CAMERA):
    depth_m = scene_of(room, camera).view(T).depth_m
    return DepthFrame(k / 10, depth_m.astype(np.float32), camera)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory, scenes):
    folder = tmp_path_factory.mktemp("fleet")
    paths = []
    for number, scene in enumerate(scenes):
        path = folder / f"map{number}.db"
        first = pose(0.0, 1.6, 1.6)
        with MapSession.open(path, config=CONFIG) as session:
            for k in range(N_FRAMES):
                T = pose(0.08 * k, 1.6, 1.6)
                session.closer.process(look(scene, T, k), se3.inverse(first) @ T)
        paths.append(path)
    Atlas.add(folder / "atlas", paths)
    return folder


@pytest.fixture(scope="module")
def robot(fleet):
    """A localizer that keeps both maps loaded."""
    return AtlasLocalizer(Atlas.open(fleet / "atlas"))


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("camera", [CAMERA, OTHER])
def test_a_frame_is_localized_in_its_map(fleet, robot, scenes, number, camera):
    T = pose(0.63, 1.68, 1.55)
    frame = look(scenes[number], T, camera=camera)
    found = robot.localize(frame)
    assert found.map is not None, found.reason
    assert found.map.path == str((fleet / f"map{number}.db").resolve())
    error = se3.inverse(found.located.localization.T_map_camera) @ (
        se3.inverse(pose(0.0, 1.6, 1.6)) @ T
    )
    assert np.linalg.norm(error[:3, 3]) < 0.05
    assert se3.rotation_angle(error) < 0.05
    assert found.located.keyframe is not None


def test_what_no_map_shows_is_not_known(robot):
    elsewhere = make_room("bathroom", seed=1)
    found = robot.localize(look(elsewhere, pose(0.3, 1.0, 1.0)))
    assert found.map is None
    assert found.located is None
    assert found.reason


def test_two_maps_of_one_place_are_not_told_apart(fleet, scenes, tmp_path):
    atlas, copy = tmp_path / "atlas", tmp_path / "copy.db"
    copy.write_bytes((fleet / "map0.db").read_bytes())
    Atlas.add(atlas, [fleet / "map0.db", copy])
    found = AtlasLocalizer(Atlas.open(atlas)).localize(look(scenes[0], pose(0.63, 1.68, 1.55)))
    assert found.map is None
    assert found.reason.startswith("2 maps match the image, such as ")


def test_a_map_that_is_gone_is_no_answer(fleet, scenes, tmp_path):
    atlas, copy = tmp_path / "atlas", tmp_path / "copy.db"
    copy.write_bytes((fleet / "map0.db").read_bytes())
    Atlas.add(atlas, [copy])
    copy.unlink()
    found = AtlasLocalizer(Atlas.open(atlas)).localize(look(scenes[0], pose(0.63, 1.68, 1.55)))
    assert found.map is None
    assert str(copy) in found.reason


def test_an_empty_atlas_knows_nothing(fleet, scenes, tmp_path):
    Atlas.add(tmp_path / "atlas", [fleet / "map0.db"])
    Atlas.remove(tmp_path / "atlas", [fleet / "map0.db"])
    found = AtlasLocalizer(Atlas.open(tmp_path / "atlas")).localize(
        look(scenes[0], pose(0, 1.6, 1.6))
    )
    assert (found.map, found.reason) == (None, "no keyframe of the atlas matches")


def test_few_maps_stay_loaded(fleet, scenes):
    localizer = AtlasLocalizer(Atlas.open(fleet / "atlas"), n_maps=1, n_loaded=1)
    for number in (0, 1, 0):
        found = localizer.localize(look(scenes[number], pose(0.63, 1.68, 1.55)))
        assert found.map.path.endswith(f"map{number}.db")
        assert list(localizer._loaded) == [found.map.path]


def test_the_same_map_gives_the_same_bytes(fleet):
    one, other = (describe_map(fleet / "map0.db") for _ in range(2))
    assert one.ids.tobytes() == other.ids.tobytes()
    ours, theirs = one.index.columns(), other.index.columns()
    assert {name: array.tobytes() for name, array in ours.items()} == {
        name: array.tobytes() for name, array in theirs.items()
    }
    assert one.R_level_camera.tobytes() == other.R_level_camera.tobytes()


def test_the_commands(fleet, scenes, tmp_path):
    run = CliRunner().invoke
    atlas, maps = str(tmp_path / "atlas"), [str(fleet / f"map{k}.db") for k in (0, 1)]
    added = run(app, ["atlas", "add", atlas, *maps, "--json"])
    assert added.exit_code == 0, added.output
    entries = json.loads(added.output)["maps"]
    assert [entry["map"] for entry in entries] == maps
    assert all(entry["n_keyframes"] > 2 for entry in entries)
    assert "2 maps with" in run(app, ["atlas", "list", atlas]).output
    image = tmp_path / "image.npy"
    np.save(image, look(scenes[1], pose(0.63, 1.68, 1.55)).depth)
    camera = ["--intrinsics", "130", "130", "79.5", "59.5"]
    found = run(app, ["atlas", "localize", atlas, str(image), *camera, "--json"])
    assert found.exit_code == 0, found.output
    assert json.loads(found.output)["map"] == maps[1]
    assert (
        "map1.db"
        in run(app, ["atlas", "localize", atlas, str(image), *camera, "--format", "csv"]).output
    )
    assert run(app, ["atlas", "remove", atlas, maps[1]]).exit_code == 0
    found = run(app, ["atlas", "localize", atlas, str(image), *camera, "--json"])
    assert json.loads(found.output)["is_known"] is False
    wrong = run(app, ["atlas", "remove", atlas, maps[1]])
    assert (wrong.exit_code, wrong.output.count("\n")) == (1, 1)
    assert run(app, ["atlas", "list", str(tmp_path)]).exit_code == 1


@pytest.mark.parametrize("where", ["map", "atlas"])
def test_a_frame_that_cannot_be_read_is_unknown_among_others(fleet, scenes, tmp_path, where):
    (tmp_path / "depth").mkdir()
    camera = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    for k in range(3):
        depth_m = look(scenes[0], pose(0.08 * k, 1.6, 1.6)).depth
        cv2.imwrite(str(tmp_path / f"depth/{k}.png"), (1000.0 * depth_m).astype(np.uint16))
    half = (tmp_path / "depth/1.png").read_bytes()[:3000]
    (tmp_path / "depth/1.png").write_bytes(half)
    command = {"map": ["localize", fleet / "map0.db"], "atlas": ["atlas", "localize"]}[where]
    command += [fleet / "atlas"] * (where == "atlas")
    found = CliRunner().invoke(app, [*map(str, command), str(tmp_path), "--json"])
    assert found.exit_code == 0, found.output
    rows = json.loads(found.output)
    assert [row["frame_index"] for row in rows] == [0, 1, 2]
    assert [row["is_known"] for row in rows] == [True, False, True]
    assert "1.png" in rows[1]["reason"]
