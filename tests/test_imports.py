"""What may be missing, and what must not be imported too early; each in its own interpreter."""

from __future__ import annotations

import subprocess
import sys

import pytest

BLOCK = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"{name} is blocked", name=name)
BLOCKED = {"kiss_icp", "open3d", "gtsam"}
sys.meta_path.insert(0, Blocker())
"""


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_blocker_blocks() -> None:
    code = BLOCK + (
        "for name in BLOCKED:\n"
        "    try:\n        __import__(name)\n"
        "    except ModuleNotFoundError:\n        continue\n"
        "    raise SystemExit(name)\n"
    )
    python(code)


def test_places_and_scenes_work_without_the_slam_libraries() -> None:
    code = BLOCK + (
        "import numpy as np\n"
        "import slam_bof\n"
        "from slam_bof.bof import InvertedIndex, PlaceDescriber, PlaceParams, descriptors\n"
        "from slam_bof.scenes import SceneClassifier\n"
        "from slam_bof.bof import TfIdf, Vocabulary, count_words\n"
        "from slam_bof.types import DepthFrame, Intrinsics\n"
        "import slam_bof.scenes.model, slam_bof.loops.detector, slam_bof.loops.covisibility\n"
        "import slam_bof.tracking.keyframe_selection\n"
        "camera = Intrinsics(160, 120, 146.25, 146.25, 80.0, 60.0)\n"
        "rng = np.random.default_rng(0)\n"
        "def frame(stamp_s):\n"
        "    depth = np.full((120, 160), 3000.0)\n"
        "    for _ in range(8):\n"
        "        y, x = rng.integers(0, 90), rng.integers(0, 120)\n"
        "        depth[y:y + 30, x:x + 40] = rng.integers(800, 2900)\n"
        "    return DepthFrame(stamp_s, depth.astype(np.uint16), camera)\n"
        "params = PlaceParams()\n"
        "frames = [frame(i) for i in range(6)]\n"
        "values = [descriptors(f, params) for f in frames]\n"
        "vocabulary = Vocabulary(n_words=8).fit(np.vstack(values))\n"
        "words = [vocabulary.predict(v) for v in values]\n"
        "tf_idf = TfIdf().fit(np.array([np.bincount(w, minlength=8) for w in words]))\n"
        "describer = PlaceDescriber(params, vocabulary, tf_idf)\n"
        "index = InvertedIndex(8)\n"
        "bags = [describer.describe(f) for f in frames]\n"
        "for bag in bags:\n    index.add(bag)\n"
        "scores = index.scores(bags[2])\n"
        "assert scores.argmax() == 2, scores\n"
        "print(sorted({m.split('.')[0] for m in sys.modules} & BLOCKED))\n"
    )
    assert python(code).strip() == "[]"


def test_the_named_front_door_opens_without_the_slam_libraries() -> None:
    code = BLOCK + "from slam_bof import DepthFrame, Intrinsics, LoopCloser; print(LoopCloser)"
    assert "LoopCloser" in python(code)


def test_everything_the_package_promises_is_there() -> None:
    python(
        "import slam_bof\n"
        "for name in slam_bof.__all__:\n    getattr(slam_bof, name)\n"
        "assert set(slam_bof.__all__) <= set(dir(slam_bof))\n"
        "assert not hasattr(slam_bof, 'no_such_name')\n"
    )


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["version"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys\n"
        "from slam_bof.cli import app\n"
        f"app({arguments!r}, prog_name='slam-bof', standalone_mode=False)\n"
        "heavy = {'numpy', 'scipy', 'sklearn', 'cv2', 'open3d', 'gtsam', 'kiss_icp', 'plotly'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    assert python(code)
