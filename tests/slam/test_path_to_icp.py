"""The number of calls that a reader follows from ``LoopCloser.process`` to the steps of ICP."""

import sys

import pytest

from slam_bof.geometry import projective_icp
from slam_bof.slam import LoopCloser

MAX_CALLS = 6
PACKAGES = ("slam_bof.", "slam_bof_plugins.")


def calls_since_process(frame):
    """Return the functions from below ``LoopCloser.process`` to a frame of the stack.

    There are none if ``process`` is not on the stack.
    """
    calls = []
    while frame is not None:
        module, function = frame.f_globals.get("__name__", ""), frame.f_code.co_qualname
        if function == "LoopCloser.process":
            return calls[::-1]
        if module.startswith(PACKAGES):
            calls.append(function)
        frame = frame.f_back
    return []


@pytest.fixture(scope="module")
def paths(walk):
    """The ways by which the loop closer comes to align views in a walk with loops."""
    found, refine = set(), projective_icp.refine

    def noted(*arguments):
        found.add((*calls_since_process(sys._getframe(1)), "refine"))
        return refine(*arguments)

    closer = LoopCloser.from_preset()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(projective_icp, "refine", noted)
        for frame, T_odom_camera in walk:
            closer.process(frame, T_odom_camera)
    return found


@pytest.mark.parametrize(
    "stage", ["Tracker.track", "PlaceRecogniser.recognise", "LoopVerification.align"]
)
def test_alignment_is_few_calls_below_process(paths, stage):
    own = [path for path in paths if stage in path]
    assert own, f"{stage} has aligned nothing"
    for path in own:
        assert len(path) <= MAX_CALLS, " > ".join(path)
