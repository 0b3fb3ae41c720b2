"""``slam-bof query`` about labels, rooms and single depth images."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from commands import refusal, slam_bof
from conftest import CAMERA, box_room_depth_mm
from saved_maps import make_loop, save

from slam_bof.bof import PlaceParams
from slam_bof.geometry import se3
from slam_bof.scenes import MapRoom, TrainingFrame, model, train_model
from slam_bof.store import MapStore, SessionResult
from slam_bof.types import (
    Bag,
    Candidate,
    CandidateSource,
    Decision,
    DepthFrame,
    Keyframe,
    Scene,
)

CLASSES = ("kitchen", "office")


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    """The folder of a map of four keyframes along x: a slip in a kitchen, then an office."""
    own, smoothed = [0.9, 0.3, 0.8, 0.2], [0.9, 0.8, 0.8, 0.3]
    scenes = {
        name: [Scene(CLASSES[p < 0.5], max(p, 1 - p), CLASSES, np.array([p, 1 - p])) for p in ps]
        for name, ps in (("own", own), ("smoothed", smoothed))
    }
    with MapStore.create(tmp_path / "map.db") as store:
        for k, scene in enumerate(scenes["own"]):
            T = se3.pose(np.eye(3), [k, -1.0, 0.0])
            bag = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
            save(store, Keyframe(k, 10 * k, k / 2, T, bag, scene), n_frames=1)
        rooms = [
            MapRoom(0, "kitchen", 0.8, (0, 1, 2), (1.0, -1.0, 0.0), (0.0, -1, 0), (2.0, -1, 0)),
            MapRoom(1, "office", 0.7, (3,), *((3.0, -1.0, 0.0),) * 3),
        ]
        poses = np.array([k.T_odom_camera for k in store.keyframes()])
        store.finish(0, SessionResult([], poses, scenes["smoothed"], rooms))
    return tmp_path


def found(*arguments: object) -> list[dict]:
    result = slam_bof("query", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_where_is_the_kitchen(labelled: Path) -> None:
    (kitchen,) = found(labelled, "--regions", "--scene", "kitchen")
    assert kitchen["keyframe_ids"] == [0, 1, 2]
    assert kitchen["center_m"] == [1.0, -1.0, 0.0]
    assert kitchen["size_m"] == [2.0, 0.0, 0.0]
    table = slam_bof("query", labelled, "--scene", "kitchen").stdout
    assert "Rooms" in table
    assert len([line for line in table.splitlines() if "│" in line]) == 1 + 3


def test_labels_are_smoothed_or_raw(labelled: Path) -> None:
    assert [r["id"] for r in found(labelled, "--scene", "kitchen")] == [0, 1, 2]
    assert [r["id"] for r in found(labelled, "--scene", "kitchen", "--labels", "raw")] == [0, 2]
    (slip,) = found(labelled, "--keyframe", 1)
    assert (slip["scene"], slip["smoothed"], slip["region"]) == ("office", "kitchen", 0)
    assert [r["id"] for r in found(labelled, "--min-probability", 0.85)] == [0]


def test_a_label_that_none_has_and_a_time_outside_of_the_map_are_told(labelled: Path) -> None:
    with MapStore.open(labelled / "map.db") as store:
        (*_, last) = store.keyframes()
    only = slam_bof("query", labelled, "--scene", "office", "--labels", "raw")
    assert only.stderr == ""
    none = slam_bof("query", labelled, "--scene", "unknown")
    assert none.exit_code == 0
    assert none.stderr == (
        "warning: no keyframe has the smoothed label unknown; there are: kitchen 3, office 1; "
        "--labels raw counts each keyframe by itself\n"
    )
    excluded = slam_bof("query", labelled, "--scene", "office", "--min-probability", 0.99)
    assert excluded.stderr == ""
    late = slam_bof("query", labelled, "--time", 1764460000)
    assert late.stderr == (
        "warning: no keyframe was near 1764460000 s: those of the map have times from 0.000 to "
        f"{last.stamp_s:.3f} s\n"
    )
    assert "apart s" in late.stdout
    assert slam_bof("query", labelled, "--time", last.stamp_s + 0.5).stderr == ""
    assert "distance m" in slam_bof("query", labelled, "--near", 0, 0, 0).stdout


def test_numbers_of_a_place_come_with_spaces_or_commas(labelled: Path) -> None:
    for near in ([2.1, -1, 0], ["2.1,-1,0"], ["2.1, -1 0"]):
        assert [r["id"] for r in found(labelled, "--near", *near, "--limit", 2)] == [2, 3]


def test_csv_has_a_row_for_each_and_all_there_is(labelled: Path) -> None:
    result = slam_bof("query", labelled, "--format", "csv")
    rows = list(csv.DictReader(io.StringIO(result.stdout)))
    assert [row["smoothed"] for row in rows] == ["kitchen"] * 3 + ["office"]
    assert float(rows[1]["probability_office"]) == 0.7
    assert float(rows[3]["translation_m_0"]) == 3.0
    nothing = slam_bof("query", labelled, "--min-probability", 1, "--format", "csv")
    assert nothing.stdout.startswith("id,frame_index,stamp_s")
    assert len(nothing.stdout.splitlines()) == 1
    rooms = slam_bof("query", labelled, "--regions", "--format", "csv").stdout
    assert rooms.splitlines()[1].split(",")[:4] == ["0", "kitchen", "0.8", "0 1 2"]


@pytest.fixture(scope="module")
def two_kinds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that tells narrow boxes from wide ones, and a wide one as an image."""
    frames = []
    for i in range(12):
        T = se3.exp(np.array([0, 0.3 * i, 0, 0.05 * i, 0, 0]))
        label = ("narrow", "wide")[i % 2]
        half_size_m = (2.0, 1.5, 3.0) if i % 2 else (0.7, 1.2, 3.0)
        depth = box_room_depth_mm(CAMERA, T, half_size_m)
        frames.append(TrainingFrame(DepthFrame(float(i), depth, CAMERA), label, str(i)))
    folder = tmp_path_factory.mktemp("two")
    trained = train_model(frames, PlaceParams(), n_words=8, trained_on="boxes", levelled=False)
    model.save(trained, folder / "two.bof")
    cv2.imwrite(str(folder / "wide.png"), box_room_depth_mm(CAMERA, np.eye(4), (2.0, 1.5, 3.0)))
    return folder


def test_one_image_and_where_its_camera_is_from(two_kinds: Path, tmp_path: Path) -> None:
    image, trained = two_kinds / "wide.png", two_kinds / "two.bof"
    assert "wide.png: found no intrinsics.json beside it, expected --intrinsics FX FY CX CY" in (
        refusal("query", image, "--model", trained)
    )
    own = ("--intrinsics", 146.25, 146.25, 80, 60)
    assert "wide.png: found no intrinsics.json beside it, expected --depth-scale" in (
        refusal("query", image, "--model", trained, *own)
    )
    own = (*own, *MILLIMETRES)
    answer = json.loads(slam_bof("query", image, "--model", trained, *own, "--json").stdout)
    assert set(answer["probabilities"]) == {"narrow", "wide"}
    assert answer["label"] == max(answer["probabilities"], key=answer["probabilities"].get)
    assert sum(answer["probabilities"].values()) == pytest.approx(1.0)
    table = slam_bof("query", image, "--model", trained, *own).stdout
    assert "(intrinsics 146.25 146.25 80 60: as given" in table
    by = ("query", "image", image, "--model", trained, *own, "--by")
    assert slam_bof(*by, "bag").exit_code == 0
    assert "found no classifier of constellations" in refusal(*by, "constellation")

    given = ("--intrinsics", 200, 201, 80, 60, *MILLIMETRES)
    answer = json.loads(slam_bof("query", image, "--model", trained, *given, "--json").stdout)
    assert (answer["intrinsics"]["fy"], answer["intrinsics_from"]) == (201.0, "as given")
    beside = tmp_path / "wide.png"
    beside.write_bytes(image.read_bytes())
    camera = {"width": 160, "height": 120, "fx": 150, "fy": 150, "cx": 80, "cy": 60}
    (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    answer = json.loads(slam_bof("query", beside, "--model", trained, "--json").stdout)
    assert answer["intrinsics"]["fx"] == 150.0
    assert answer["intrinsics_from"] == f"from {tmp_path / 'intrinsics.json'}"

    depth = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(beside), 5 * depth)
    (tmp_path / "intrinsics.json").write_text(json.dumps({**camera, "depth_scale": 5000}))
    fifths = json.loads(slam_bof("query", beside, "--model", trained, *own[:5], "--json").stdout)
    whole = json.loads(slam_bof("query", image, "--model", trained, *own, "--json").stdout)
    assert fifths["probabilities"] == pytest.approx(whole["probabilities"], abs=0.02)


MILLIMETRES = ("--depth-scale", 1000)
OWN = ("--intrinsics", 146.25, 146.25, 80, 60)


def test_too_little_is_unknown(two_kinds: Path) -> None:
    trained = ("--model", two_kinds / "two.bof", *OWN, *MILLIMETRES)
    ask = ("query", two_kinds / "wide.png", *trained, "--json")
    answer = json.loads(slam_bof(*ask, "--min-probability", 1.0).stdout)
    assert answer["label"] == "unknown"


def test_units_of_the_image_can_be_given(two_kinds: Path, tmp_path: Path) -> None:
    depth = cv2.imread(str(two_kinds / "wide.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "fifths.png"), 5 * depth)
    np.save(tmp_path / "metres.npy", (depth / 1000.0).astype(np.float32))
    trained = ("--model", two_kinds / "two.bof", *OWN, "--json")
    plain = slam_bof("query", two_kinds / "wide.png", *trained, *MILLIMETRES)
    expected = json.loads(plain.stdout)
    for name, extra in (("fifths.png", ("--depth-scale", 5000)), ("metres.npy", ())):
        answer = json.loads(slam_bof("query", tmp_path / name, *trained, *extra).stdout)
        assert answer["probabilities"] == pytest.approx(expected["probabilities"], abs=0.02), name


def test_images_that_are_none(two_kinds: Path, tmp_path: Path) -> None:
    trained = ("--model", two_kinds / "two.bof", *OWN, *MILLIMETRES)
    assert "none.png: found no such file" in refusal("query", tmp_path / "none.png", *trained)
    cv2.imwrite(str(tmp_path / "color.png"), np.zeros((4, 5, 3), np.uint8))
    assert "found an image 4x5x3 of uint8, expected one channel of uint16" in refusal(
        "query", tmp_path / "color.png", *trained
    )
    (tmp_path / "text.png").write_text("not an image")
    assert "found no image that can be read" in refusal("query", tmp_path / "text.png", *trained)
    image = two_kinds / "wide.png"
    assert "--intrinsics: found '1,2', expected FX FY CX CY in pixels" in refusal(
        "query", image, *trained[:2], "--intrinsics", 1, 2
    )
    assert slam_bof("query", image, *trained, "--time", 1).exit_code == 2
    assert "none.bof: no such model file" in refusal("query", image, "--model", "none.bof")
    other = tmp_path / "image.png"
    other.write_bytes(image.read_bytes())
    (tmp_path / "intrinsics.json").write_text('{"width": 1}')
    assert "expected JSON with width, height" in refusal("query", other, *trained[:2])


def test_images_that_cannot_be_what_they_are_taken_for(two_kinds: Path, tmp_path: Path) -> None:
    trained = ("--model", two_kinds / "two.bof")
    image = two_kinds / "wide.png"
    assert slam_bof("query", image, *trained, *OWN, *MILLIMETRES).stderr == ""
    wrong = slam_bof("query", image, *trained, *OWN, "--depth-scale", 100)
    assert wrong.exit_code == 0
    assert wrong.stderr.startswith(f"warning: {image}: ")
    assert "divided by 10 (units of 0.1 mm, as of RealSense D405)" in wrong.stderr
    cv2.imwrite(str(tmp_path / "dark.png"), np.zeros((120, 160), np.uint16))
    dark = slam_bof("query", tmp_path / "dark.png", *trained, *OWN, *MILLIMETRES)
    assert dark.stderr == f"warning: {tmp_path / 'dark.png'}: no pixel has a depth\n"
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((120, 160), 200, np.uint8))
    assert "found an image of 8 bits, which reaches 0.255 m with depth_scale 1000" in refusal(
        "query", tmp_path / "grey.png", *trained, *OWN, *MILLIMETRES
    )


def test_a_map_that_is_named_for_its_camera_is_there_and_of_that_camera(
    two_kinds: Path, labelled: Path, tmp_path: Path
) -> None:
    trained = ("--model", two_kinds / "two.bof")
    cv2.imwrite(str(tmp_path / "large.png"), np.full((240, 320), 2000, np.uint16))
    assert "large.png: found 320x240 pixels, expected 64x48" in refusal(
        "query", tmp_path / "large.png", *trained, "--map", labelled, *MILLIMETRES
    )
    camera = {"width": 320, "height": 240, "fx": 300, "fy": 300, "cx": 160, "cy": 120}
    (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    assert "none.db: found no file" in refusal(
        "query", "image", tmp_path / "large.png", *trained, "--map", tmp_path / "none.db"
    )


def test_tables_call_labels_as_json_does(labelled: Path) -> None:
    (record,) = found(labelled, "--keyframe", 1)
    table = slam_bof("query", labelled, "--keyframe", 1).stdout.splitlines()
    head, row = ([cell.strip() for cell in line.strip("│┃").replace("┃", "│").split("│")]
                 for line in table if "smoothed" in line or "kitchen" in line)  # fmt: skip
    shown = dict(zip(head, row, strict=True))
    assert (shown["smoothed"], shown["scene"]) == (record["smoothed"], record["scene"])


@pytest.mark.parametrize("width", [80, 60])
def test_tables_fit_narrow_terminals(
    labelled: Path, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("FORCE_COLOR", "1")
    lines = slam_bof("query", labelled).stdout.splitlines()
    plain = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in lines]
    assert max(map(len, plain)) <= width
    text = "\n".join(plain)
    assert "…" not in text
    assert (text.count("office"), text.count("kitchen")) == (3, 5)  # whole words, none cut


def test_options_that_exclude_each_other_are_refused(labelled: Path) -> None:
    for arguments in (
        ("query", labelled, "--time", 1, "--near", 0, 0, 0),
        ("query", labelled, "--loops", "--rooms"),
        ("query", labelled, "--loops", "--scene", "kitchen"),
        ("query", labelled, "--rooms", "--near", 0, 0, 0),
        ("query", labelled, "--model", "default"),
        ("query", "loops", labelled, "--accepted", "--rejected"),
    ):
        assert slam_bof(*arguments).exit_code == 2, arguments


def test_subcommands_and_the_plain_forms_are_the_same(labelled: Path) -> None:
    assert found("keyframes", labelled) == found(labelled)
    assert found("rooms", labelled) == found(labelled, "--rooms") == found("--regions", labelled)
    assert found("loops", labelled) == found(labelled, "--loops") == []


@pytest.fixture
def parted(tmp_path: Path) -> Path:
    """A map of two components, three keyframes and two, with a loop and two pairs that are none."""
    pairs = [
        Candidate(2, 0, CandidateSource.VIEW, overlap=0.9, rmse_m=0.01, decision=Decision.ACCEPTED),
        Candidate(2, 1, CandidateSource.VIEW, decision=Decision.REJECTED, reason="overlap 0.12"),
        Candidate(4, 0, CandidateSource.VIEW, score=0.5, decision=Decision.HELD, reason="alone"),
    ]
    loop = make_loop(2, 0, source="view")
    with MapStore.create(tmp_path / "map.db") as store:
        for k in range(5):
            T = se3.pose(np.eye(3), [float(k), 0.0, 0.0])
            bag = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
            keyframe = Keyframe(k, k, k / 2, T, bag, None, segment=int(k >= 3))
            own = [c for c in pairs if c.query_id == k]
            save(store, keyframe, own, [loop] if k == 2 else [], n_frames=1)
        poses = np.array([k.T_odom_camera for k in store.keyframes()])
        store.finish(0, SessionResult([], poses, [None] * 5, []))
    return tmp_path


def test_loops_are_the_audit_trail(parted: Path) -> None:
    trail = [(r["query_id"], r["match_id"], r["decision"], r["reason"]) for r in
             found("loops", parted)]  # fmt: skip
    rejected = [(2, 1, "rejected", "overlap 0.12"), (4, 0, "held", "alone")]
    assert trail == [(2, 0, "accepted", ""), *rejected]
    assert [r["match_id"] for r in found("loops", parted, "--accepted")] == [0]
    assert [r["reason"] for r in found("loops", parted, "--rejected")] == ["overlap 0.12", "alone"]
    assert [r["query_id"] for r in found("loops", parted, "--keyframe", 1)] == [2]
    table = slam_bof("query", "loops", parted).stdout
    assert "overlap 0.12" in table


def test_components_are_told_apart(parted: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert [r["component"] for r in found(parted)] == [0, 0, 0, 1, 1]
    assert [r["id"] for r in found(parted, "--component", 1)] == [3, 4]
    assert [r["component"] for r in found("loops", parted)] == [0, 0, 1]
    assert not caplog.text
    near = ("--near", 4, 0, 0)
    assert [r["id"] for r in found(parted, *near)] == [2, 1, 0]
    assert "warning: " in slam_bof("query", parted, *near).stderr
    assert "2 components that no loop has joined; taking the largest, component 0, with 3 of 5" in (
        caplog.text
    )
    assert [r["id"] for r in found(parted, *near, "--component", 1)] == [4, 3]
    assert "found no component 7, expected one of: 0, 1" in refusal(
        "query", parted, "--component", 7
    )


def test_uncertainty_is_printed_where_it_is_asked_for(parted: Path) -> None:
    """It grows from keyframe to keyframe, less where a loop leads back, anew in each component."""
    assert "sigma_m" not in found(parted)[0]
    sigmas = [r["sigma_m"] for r in found(parted, "--uncertainty")]
    assert sigmas[0] == sigmas[3] == 0.0
    assert 0.0 < sigmas[2] < sigmas[1]
    assert sigmas[4] == pytest.approx(sigmas[1])
    table = slam_bof("query", parted, "--uncertainty", "--format", "csv").stdout.splitlines()
    assert table[0].endswith("sigma_m,sigma_degrees")


def test_exports_have_one_component(parted: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for form in ("tum", "kitti", "csv", "g2o"):
        for more, n in (((), 3), (("--component", 1), 2)):
            result = slam_bof("export", parted, "--format", form, "-o", out, *more, "--json")
            assert json.loads(result.stdout)["n_keyframes"] == n
            lines = out.read_text().splitlines()
            kept = [line for line in lines if not line.startswith(("EDGE", "FIX", "id"))]
            assert len(kept) == n, form
    graph = out.read_text().splitlines()
    assert [line.split()[1] for line in graph if line.startswith("VERTEX")] == ["3", "4"]
    assert [line.split()[1:3] for line in graph if line.startswith("EDGE")] == [["3", "4"]]
    all_frames = ("export", parted, "--all-frames", "-o", out, "--format", "tum")
    assert slam_bof(*all_frames).exit_code == 0
    assert len(out.read_text().splitlines()) == 3
