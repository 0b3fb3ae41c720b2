"""The Python of the tutorial runs as it is printed."""

from __future__ import annotations

import re
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from conftest import ROOT

from slam_bof import LoopCloser
from slam_bof.types import DepthFrame, Pose

PAGE = ROOT / "docs/tutorial/own-odometry.md"
SNIPPETS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


def test_the_page_has_the_snippets_that_are_run() -> None:
    assert len(SNIPPETS) == 5
    for what in ("closer.finish", "background=True", "process_points", "pairing", "recognise("):
        assert sum(what in snippet for snippet in SNIPPETS) == 1


@pytest.mark.parametrize("snippet", SNIPPETS, ids=range(len(SNIPPETS)))
def test_a_snippet_runs_from_the_first_frame_on(
    snippet: str, walk: list[tuple[DepthFrame, Pose]]
) -> None:
    first, T = walk[0]
    frames: SimpleQueue[DepthFrame] = SimpleQueue()
    frames.put(first)
    names: dict[str, Any] = {
        "LoopCloser": LoopCloser,
        "my_odometry": [(frame.stamp_s, frame.depth, T) for frame, T in walk[:12]],
        "my_keyframes": walk[:25],
        "frames": frames,
        "stamp_s": first.stamp_s,
        "T_odom_camera": T,
        "points_camera": np.random.default_rng(0).uniform(1.0, 3.0, (2000, 3)),
    }
    if "closer =" not in snippet:
        names["closer"] = LoopCloser.from_preset("indoor")
    exec(snippet, names)
    if "trajectory" in names:
        assert len(names["trajectory"]) == 12
    if "match" in names:
        assert names["match"].view_id < 5
    if "pairing" in names:
        assert len(names["closer"].history) == 1
    if "closer" in names:
        names["closer"].close()
