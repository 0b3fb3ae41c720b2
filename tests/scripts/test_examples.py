"""The scripts under scripts/examples, each run as a stranger would."""

import importlib.util
import os
import re
import subprocess
import sys

import pytest
from conftest import ROOT

EXAMPLES = ROOT / "scripts" / "examples"


def run(name, *arguments):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *map(str, arguments)],
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout, done.stderr


def test_inside_kiss_icp():
    code, out, err = run("inside_kiss_icp.py")
    assert code == 0, err
    found = re.search(r"(\d+) loops\nATE (\S+) m by KISS-ICP, (\S+) m after loops", out)
    assert found, out
    assert int(found[1]) > 20
    assert float(found[3]) < 0.7 * float(found[2])


def test_inside_kiss_slam():
    if importlib.util.find_spec("kiss_slam") is None:
        pytest.skip("needs kiss-slam; scripts/test installs it")
    code, out, err = run("inside_kiss_slam.py")
    assert code == 0, err
    found = re.search(r"(\d+) loops by slam_bof, ATE (\S+) m", out)
    assert found, out
    assert int(found[1]) > 5
    assert float(found[2]) < 0.1


def test_without_kiss_slam_one_line_says_so():
    hidden = "import sys; sys.argv = ['it']; sys.modules['kiss_slam'] = None; import runpy; "
    code = f"{hidden}runpy.run_path({str(EXAMPLES / 'inside_kiss_slam.py')!r}, run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.argv = ['it']; {code}"],
        env={**os.environ, "PYTHONPATH": str(EXAMPLES)},
        capture_output=True,
        text=True,
    )
    assert done.stderr == "kiss_slam is not installed; try: pip install kiss-slam\n"
    assert done.returncode == 1


def test_live(write_turn, tmp_path):
    folder = tmp_path / "room" / "seq-01"
    write_turn(folder, [0.02 * k for k in range(40)])
    code, out, err = run("live.py", folder)
    assert code == 0, err
    assert re.match(r"40 of 40 frames, \d+ keyframes, \d+ loops; at most \d+ frames waited\n$", out)
    code, _, err = run("live.py", tmp_path / "none")
    assert code == 1
    assert err.count("\n") == 1
