import base64
import json
import re
import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.scenes import MapRoom
from slam_bof.types import (
    Array,
    Bag,
    Candidate,
    CandidateSource,
    Decision,
    EdgeKind,
    Keyframe,
    Loop,
    Scene,
    Trajectory,
)
from slam_bof.visualization import FrameHealth, PicturedPair, Plan, ReportData, write_report

CLASSES = ("kitchen", "office")
METRICS = {
    "dataset": "7scenes",
    "sequence": "redkitchen/seq-01",
    "n_frames": 40,
    "n_loops": 2,
    "ate_odometry_m": 0.0812,
    "ate_m": 0.0523,
    "loop_precision": 0.5,
    "scene_accuracy": None,
    "fps": 18.44,
    "stage_ms.read": 6.1,
    "stage_ms.total": 54.2,
    "seed": 0,
    "version": "0.1.0",
    "n_surprises": 3,
}


def circle(n: int, radius_m: float) -> Trajectory:
    angles = np.linspace(0.0, 2.0 * np.pi, n)
    tangents = np.zeros((n, 6))
    tangents[:, 1] = angles
    poses = se3.exp(tangents)
    poses[:, 0, 3] = radius_m * (np.cos(angles) - 1.0)
    poses[:, 2, 3] = radius_m * np.sin(angles)
    return Trajectory(np.arange(n) / 30.0, poses)


def make_keyframe(id_: int, frame_index: int, T_odom_camera: Array) -> Keyframe:
    scene = Scene(CLASSES[id_ % 2], 0.75, CLASSES, np.array([0.75, 0.25]))
    bag = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
    return Keyframe(id_, frame_index, frame_index / 30.0, T_odom_camera, bag, scene)


@pytest.fixture
def data() -> ReportData:
    odometry, optimized, truth = circle(40, 1.1), circle(40, 1.01), circle(40, 1.0)
    keyframes = [make_keyframe(k, 4 * k, odometry.poses[4 * k]) for k in range(10)]
    T_0_9 = se3.inverse(truth.poses[0]) @ truth.poses[36]
    loops = [
        Loop(9, 0, T_0_9, np.eye(6), EdgeKind.LOOP, CandidateSource.BAG),
        Loop(8, 0, np.eye(4), np.eye(6), EdgeKind.LOOP, CandidateSource.PROXIMITY),
        Loop(9, 8, np.eye(4), np.eye(6), EdgeKind.COVISIBILITY, CandidateSource.PROXIMITY),
    ]
    candidates = [
        Candidate(
            9,
            0,
            CandidateSource.BAG,
            eta=0.9,
            overlap=0.7,
            decision=Decision.ACCEPTED,
            reason="overlap 0.70",
        ),
        Candidate(
            9, 1, CandidateSource.BAG, eta=np.inf, decision=Decision.REJECTED, reason="eta too good"
        ),
        Candidate(
            9,
            2,
            CandidateSource.PROXIMITY,
            overlap=0.1,
            decision=Decision.REJECTED,
            reason="overlap 0.10",
        ),
        Candidate(
            9, 8, CandidateSource.PROXIMITY, kind=EdgeKind.COVISIBILITY, decision=Decision.ACCEPTED
        ),
    ]
    poses = truth.poses.copy()
    poses[20:25] = np.nan
    known = Trajectory(truth.stamps_s, poses)
    true_scenes = ["kitchen"] * 9 + [None]
    return ReportData(
        METRICS, odometry, optimized, known, keyframes, loops, candidates, true_scenes
    )


def headings(html: str) -> list[str]:
    return re.findall("<h2>(.*?)</h2>", html)


def plots(html: str) -> dict[str, list]:
    """Return the traces of each figure by its div id."""
    calls = re.findall(r'Plotly\.newPlot\(\s*"([^"]+)",\s*(\[.*?\]),\s*\{"', html)
    return {div_id: json.loads(traces) for div_id, traces in calls}


def write(tmp_path: Path, data: ReportData) -> str:
    write_report(tmp_path / "report.html", data)
    return (tmp_path / "report.html").read_text(encoding="utf-8")


def without_library(html: str) -> str:
    """Cut plotly.js, which the page carries with it, out of the page."""
    start, end = html.index("<script>"), html.index("</head>")
    return html[:start] + html[end:]


def test_the_page_has_every_figure(tmp_path: Path, data: ReportData) -> None:
    html = write(tmp_path, data)
    assert headings(html) == [
        "Trajectory", "Position error", "Loop candidates", "Scene labels", "Time", "All metrics",
    ]  # fmt: skip
    assert set(plots(html)) == {
        "top-view", "space-view", "errors", "candidates", "reasons", "labels", "stages",
    }  # fmt: skip


@pytest.fixture
def plan() -> Plan:
    """Two rooms side by side, 0.5 m each, with a wall along the top; the map's frame has y down."""
    cells = np.full((4, 10), 254, np.uint8)
    cells[0], cells[3, 0] = 0, 205
    rooms = [
        MapRoom(k, label, 0.9, ids, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        for k, (label, ids) in enumerate([("kitchen", (0, 1)), ("office", (2,))])
    ]
    T_plan_map = se3.pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.0, 0.0, 0.0])
    positions_plan = np.array([[-0.3, 0.0, 1.4], [-0.2, 0.0, 1.4], [0.3, 0.0, 1.4]])
    positions_map = se3.transform(se3.inverse(T_plan_map), positions_plan)
    return Plan(cells, 0.1, (-0.5, -0.2), T_plan_map, positions_map, rooms, [[0, 1], [2]])


def test_the_plan_shows_rooms_by_colour_and_name(tmp_path: Path, data, plan: Plan) -> None:
    html = write(tmp_path, replace(data, plans=[plan]))
    assert headings(html)[0] == "Place"
    traces = {trace["name"]: trace for trace in plots(html)["plan"]}
    assert traces["office"]["text"] == ["keyframe 2, office 1"]
    assert traces["path of the camera"]["x"] == [-0.3, -0.2, None, 0.3, None]
    assert r"\u003cb\u003eoffice\u003c\u002fb\u003e" in html
    image = plan_image(without_library(html))
    kitchen, office = (traces[name]["marker"]["color"] for name in ("kitchen", "office"))
    assert image.shape == (4, 10, 3)
    assert image[0].max() < 60, "the wall"
    assert image[3, 0].tolist() == [238, 238, 238], "unknown"
    for column, color in ((2, kitchen), (8, office)):
        tint = 255 - image[2, column].astype(float)
        full = 255 - np.array(list(bytes.fromhex(color[1:])), float)
        np.testing.assert_allclose(tint, 0.35 * full, atol=1.0)


def test_components_are_apart(tmp_path: Path, data, plan: Plan) -> None:
    """Keyframes 0 to 5, and 6 to 9 of another component from frame 24 on."""
    metrics = {**METRICS, "n_components": 2}
    components = [0] * 6 + [1] * 4
    apart = replace(data, metrics=metrics, plans=[plan, plan], components=components)
    html = write(tmp_path, apart)
    assert {"plan", "plan-2"} <= set(plots(html))
    assert "each has a plan of its own" in html
    for name in ("top-view", "space-view"):
        traces = {trace.get("name"): trace for trace in plots(html)[name]}
        x = {n: decoded(traces[n]["x"]) for n in ("with loops", "component 1")}
        np.testing.assert_array_equal(np.isnan(x["with loops"]), np.arange(40) >= 24)
        np.testing.assert_array_equal(np.isnan(x["component 1"]), np.arange(40) < 24)
        colors = [
            np.array([*bytes.fromhex(trace["line"]["color"][1:])])
            for name, trace in traces.items()
            if name in ("odometry alone", "with loops", "component 1")
        ]
        assert len(colors) == 3
        assert min(np.linalg.norm(a - b) for a, b in combinations(colors, 2)) > 60
    with pytest.raises(ValueError, match="for each of 10 keyframes, got 1"):
        replace(data, components=[0])


def decoded(values: dict[str, str]) -> Array:
    """Decode an array as plotly writes it."""
    text = values["bdata"].replace(r"\u002f", "/").replace(r"\u003d", "=")
    return np.frombuffer(base64.b64decode(text), values["dtype"])


def test_a_keyframe_lists_all_of_its_loops(tmp_path: Path, data: ReportData) -> None:
    many = [replace(data.loops[0], query_id=9, match_id=k % 9) for k in range(30)]
    top_view = plots(write(tmp_path, replace(data, loops=many)))["top-view"]
    (keyframes,) = [trace for trace in top_view if trace.get("name") == "keyframes"]
    assert keyframes["text"][9] == "keyframe 9<br>loops with 0, 1, 2, 3, 4, 5, 6, 7, 8"
    assert keyframes["text"][0] == "keyframe 0<br>loops with 9"


def plan_image(html: str) -> NDArray[np.uint8]:
    """Decode the image of the plan, RGB."""
    text = html.replace(r"\u002f", "/").replace(r"\u003d", "=")
    (encoded,) = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", text)
    image = cv2.imdecode(np.frombuffer(base64.b64decode(encoded), np.uint8), cv2.IMREAD_COLOR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def test_warnings_come_first(tmp_path: Path, data: ReportData) -> None:
    assert "Warnings" not in headings(write(tmp_path, data))
    html = write(tmp_path, replace(data, warnings=["<odd> depth", *map(str, range(24))]))
    assert headings(html)[0] == "Warnings"
    assert "<li>&lt;odd&gt; depth</li><li>0</li>" in html
    assert "5 more are in run.log" in html


def test_health_is_drawn_over_time(tmp_path: Path, data: ReportData) -> None:
    health = [FrameHealth("tracked", 0)] * 20 + [FrameHealth("degenerate", 2)] * 15
    health += [FrameHealth("lost", 0)] * 5
    html = write(tmp_path, replace(data, health=health))
    assert "Of 40 frames: 20 tracked, 15 degenerate, 5 lost." in html
    of_frames, lost = plots(html)["health"]
    assert lost["name"] == "lost (5)"
    assert of_frames["name"] == "of 6, by frame"
    assert "Tracking" not in headings(write(tmp_path, replace(data, health=health[1:])))


def test_uncertainty_is_drawn_but_for_lost_frames(tmp_path: Path, data: ReportData) -> None:
    health = [FrameHealth("tracked", 0, 0.01 * k, 0.001 * k) for k in range(35)]
    health += [FrameHealth("lost", 0, 17.0, 17.0)] * 5
    position, direction = plots(write(tmp_path, replace(data, health=health)))["uncertainty"]
    assert (position["name"], direction["name"]) == ("position (m)", "direction (degrees)")
    unknown = [FrameHealth("tracked", 0)] * 40
    assert "Uncertainty" not in headings(write(tmp_path, replace(data, health=unknown)))


def test_command_and_configuration_are_text(tmp_path: Path, data: ReportData) -> None:
    made = replace(data, command="slam-bof run 'a & b'", configuration="seed: 0\n# <b>\n")
    html = without_library(write(tmp_path, made))
    assert headings(html)[-1] == "How it was made"
    assert "<summary>slam-bof run &#x27;a &amp; b&#x27;</summary>" in html
    assert "# &lt;b&gt;" in html


def test_loops_are_told_from_wrong_ones_and_covisibility(tmp_path: Path, data) -> None:
    top_view = plots(write(tmp_path, data))["top-view"]
    names = {trace.get("name") for trace in top_view}
    assert {"loops (1)", "wrong loops (1)", "covisibility edges (1)"} <= names
    untold = plots(write(tmp_path, replace(data, groundtruth=None)))["top-view"]
    names = {trace.get("name") for trace in untold}
    assert "loops (2)" in names
    assert "ground truth" not in names


def test_more_loops_than_can_be_told_apart_are_thinned(tmp_path: Path, data) -> None:
    loops = [replace(data.loops[0], query_id=k % 9 + 1, match_id=0) for k in range(200)]
    top_view = plots(write(tmp_path, replace(data, loops=loops, groundtruth=None)))["top-view"]
    (drawn,) = [t for t in top_view if t.get("name", "").startswith("loops (")]
    assert drawn["name"] == "loops (67 of 200 drawn)"
    assert len(drawn["x"]) == 3 * 67


def test_candidates_show_the_decision_and_its_reason(tmp_path: Path, data) -> None:
    html = write(tmp_path, data)
    traces = plots(html)["candidates"]
    reasons = {t["name"]: " ".join(t["text"]) for t in traces}
    assert "keyframe 9 with 0, by bag" in reasons["accepted"]
    assert "rejected: overlap 0.10" in reasons["rejected"]
    assert "3 pairs of keyframes considered, 1 accepted" in html
    assert "Infinity" not in without_library(html)


def test_labels_are_compared_with_the_truth(tmp_path: Path, data: ReportData) -> None:
    traces = {t["name"]: t for t in plots(write(tmp_path, data))["labels"]}
    assert len(traces["predicted, correct"]["text"]) == 5
    assert len(traces["predicted, wrong"]["text"]) == 4
    assert len(traces["predicted"]["text"]) == 1
    assert len(traces["true"]["y"]) == 9


def test_metrics_are_written_for_people(tmp_path: Path, data: ReportData) -> None:
    html = without_library(write(tmp_path, data))
    assert "<h1>redkitchen/seq-01</h1>" in html
    assert "7scenes · 40 frames · 1.3 s · 10 keyframes · slam_bof 0.1.0 · seed 0" in html
    assert '<div class="value">0.052 m</div>' in html
    assert "odometry alone: 0.081 m" in html
    assert '<div class="value unknown">unknown</div>' in html
    assert "<tr><th>ATE with loops (RMSE)</th><td>0.0523 m</td></tr>" in html
    assert "<tr><th>n_surprises</th><td>3</td></tr>" in html
    assert "None" not in html


def test_a_run_without_loops_has_ground_truth_all_the_same(tmp_path: Path, data) -> None:
    metrics = {**METRICS, "n_loops": 0, "loop_precision": None}
    html = write(tmp_path, replace(data, metrics=metrics))
    assert "none to compare with ground truth" in html
    assert "no ground truth" not in html


def test_the_page_needs_no_network(tmp_path: Path, data: ReportData) -> None:
    html = write(tmp_path, data)
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=", html)
    assert "http" not in without_library(html)
    assert "plotly.js v" in html


def test_the_same_run_gives_the_same_bytes(tmp_path: Path, data: ReportData) -> None:
    assert write(tmp_path, data) == write(tmp_path, data)


def test_accepted_and_rejected_loops_are_shown(tmp_path: Path, data: ReportData) -> None:
    depth_m = np.full((24, 64), 1.0, np.float32)
    depth_m[:, 32:] = 4.0
    pairs = [PicturedPair(c, depth_m) for c in data.candidates[:3]]
    html = write(tmp_path, replace(data, pairs=pairs))
    assert [h for h in headings(html) if h.startswith("Loops ")] == [
        "Loops accepted",
        "Loops rejected",
    ]
    assert "<figcaption>keyframes 9 and 1: eta too good</figcaption>" in html
    pictures = re.findall('src="data:image/jpeg;base64,([^"]+)"', html)
    assert len(pictures) == 3
    image = cv2.imdecode(np.frombuffer(base64.b64decode(pictures[0]), np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (120, 320, 3)
    left, right = image[:, :150].astype(float).mean(), image[:, 170:].astype(float).mean()
    assert right > left + 20, "what is farther away is brighter"


def test_a_run_without_truth_loops_or_labels(tmp_path: Path, data: ReportData) -> None:
    keyframes = [replace(keyframe, scene=None) for keyframe in data.keyframes]
    bare = ReportData({}, data.odometry, data.optimized, None, keyframes)
    html = write(tmp_path, bare)
    assert headings(html) == ["Trajectory"]
    assert "Unnamed sequence" in html
    assert "The ground truth of this sequence is unknown" in html


@pytest.mark.parametrize("n", [0, 1, 2])
def test_runs_of_hardly_any_frames(tmp_path: Path, data: ReportData, n: int) -> None:
    short = Trajectory(data.odometry.stamps_s[:n], data.odometry.poses[:n])
    keyframes = data.keyframes[: n and 1]
    html = write(tmp_path, ReportData(METRICS, short, short, data.groundtruth, keyframes))
    assert f"{n} frame{'' if n == 1 else 's'} · " in html
    assert "Position error" not in headings(html)
    assert "top-view" in plots(html)


def test_names_from_outside_are_text_and_not_html(tmp_path: Path, data: ReportData) -> None:
    evil = "</script><script>alert(1)</script>"
    candidate = Candidate(
        0, 0, CandidateSource.BAG, eta=1.0, decision=Decision.REJECTED, reason=evil
    )
    metrics = {**METRICS, "sequence": evil, evil: evil}
    html = write(tmp_path, replace(data, metrics=metrics, candidates=[candidate]))
    assert "<script>alert" not in html
    assert "&lt;/script&gt;&lt;script&gt;alert(1)" in html


def test_lengths_must_agree(data: ReportData) -> None:
    with pytest.raises(ValueError, match="for each of 10 keyframes, got 1"):
        replace(data, true_scenes=["kitchen"])
    with pytest.raises(ValueError, match="40 of odometry and 0 optimized"):
        replace(data, optimized=Trajectory())


def test_plotly_is_loaded_only_to_write() -> None:
    code = "import sys, slam_bof.visualization.run_report; sys.exit('plotly' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
