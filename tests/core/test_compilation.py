"""Compiled functions are plain ones, only faster."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slam_bof.core import compiled, find_kept

SOURCE = """
from slam_bof.core import compiled

@compiled
def total(values):
    sum = 0.0
    for value in values:
        sum += value
    return sum
"""


def test_a_function_is_compiled_for_its_arguments():
    @compiled
    def halves(values):
        return values / 2

    np.testing.assert_array_equal(halves(np.array([1.0, 3.0])), [0.5, 1.5])
    assert len(halves.signatures) == 1


def test_division_by_zero_is_infinite():
    @compiled
    def inverse(value):
        return 1.0 / value

    assert inverse(0.0) == np.inf


def test_a_function_without_a_file_is_compiled_without_being_kept():
    names = {}
    exec(SOURCE, names)
    assert names["total"](np.array([1.0, 2.0])) == 3.0
    assert find_kept(names["total"]) == ""


def test_code_is_kept_for_the_next_process(tmp_path: Path):
    (tmp_path / "sums.py").write_text(SOURCE)
    program = (
        "import numpy as np, sums; from slam_bof.core import find_kept; "
        "print(sums.total(np.ones(5)), dict(sums.total.stats.cache_hits), find_kept(sums.total))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def run() -> str:
        command = [sys.executable, "-c", program]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout

    kept_in = str(tmp_path / "cache")
    assert run().startswith(f"5.0 {{}} {kept_in}")
    again = run()
    assert again.startswith("5.0 {(Array(float64")
    assert kept_in in again


@pytest.mark.parametrize("name", ["project", "sampled_by_axis"])
def test_annotations_and_docstrings_stay(name):
    from slam_bof.geometry import projection

    function = getattr(projection, name)
    assert function.__doc__
    assert "views" in function.__annotations__
