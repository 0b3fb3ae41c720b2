"""The contract of verifier plug-ins, as a test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from slam_bof.geometry import PointParams, points_camera, se3
from slam_bof.ports import Verifier
from slam_bof.testing.scenery import blind, expect, expect_rigid, pair_of_views
from slam_bof.types import Array, DepthFrame, Pose, Verification

__all__ = ["check_verifier"]

CLOUD = PointParams(stride=4, max_range_m=4.0)
SMALL = se3.exp(np.array([0.02, -0.03, 0.02, 0.05, 0.03, -0.05]))
"""Error of the initial guess."""


def check_verifier(
    make: Callable[[], Verifier], *, max_error_m: float = 0.03, max_error_deg: float = 1.0
) -> None:
    """Check that a verifier obeys its port.

    Two views of one place are accepted and aligned, from a guess and from nothing; a view the
    other way and one that shows nothing are rejected in words, with a finite pose; many matches
    come back in their order, each as if it were alone; no match is no work; the same input
    gives the same bytes.

    Parameters
    ----------
    make
        Makes a new one: its class, if it needs no arguments.
    max_error_m, max_error_deg
        Largest error of the pose, which is 0.26 m and 12 degrees from the match's.

    Raises
    ------
    AssertionError
        In words.
    """
    *frames, T_match_query = pair_of_views()
    verifier = make()
    expect(isinstance(verifier, Verifier), "it must have what slam_bof.ports.Verifier has")
    query, match, behind, nothing = (
        _prepare(verifier, frame) for frame in (*frames, blind(frames[0])[0])
    )
    for guess, how in ((T_match_query @ SMALL, "a guess"), (None, "nothing")):
        found = _verify(verifier, query, match, guess)
        expect(found.accepted, f"from {how}, views of one place must be accepted: {found.reason}")
        expect(found.reason == "", "what is accepted has no reason against it")
        error = se3.inverse(T_match_query) @ found.T_match_query
        off_m = float(np.linalg.norm(error[:3, 3]))
        off_deg = float(np.degrees(se3.rotation_angle(error)))
        expect(
            off_m <= max_error_m and off_deg <= max_error_deg,
            f"from {how}, T_match_query is off by {off_m:.3f} m and {off_deg:.2f} degrees, "
            f"{max_error_m:g} m and {max_error_deg:g} are allowed",
        )
        other = make()
        again = _verify(other, _prepare(other, frames[0]), _prepare(other, frames[1]), guess)
        expect(
            found.T_match_query.tobytes() == again.T_match_query.tobytes()
            and found.information.tobytes() == again.information.tobytes(),
            f"from {how}, the same input must give the same bytes",
        )
    for other, what, guess in (
        (behind, "a view the other way", None),
        (nothing, "a blind frame", np.eye(4)),
    ):
        found = _verify(verifier, query, other, guess)
        expect(not found.accepted and bool(found.reason), f"{what} must be rejected in words")
        found = _verify(verifier, other, query, guess)
        expect(not found.accepted, f"{what} must be rejected as the query, too")
    _check_order(verifier, query, match, behind, T_match_query)


def _check_order(
    verifier: Verifier, query: object, match: object, behind: object, T_match_query: Pose
) -> None:
    guesses = np.stack([T_match_query, se3.pose(np.eye(3), [0.0, 0.0, 20.0])])
    together = verifier.verify(query, [match, behind], T_match_query=guesses)
    expect([v.accepted for v in together] == [True, False], "matches must come in their order")
    for found, one, guess in zip(together, (match, behind), guesses, strict=True):
        alone = _verify(verifier, query, one, guess)
        expect(
            bool(np.allclose(found.T_match_query, alone.T_match_query, atol=1e-4))
            and abs(found.overlap - alone.overlap) < 2e-3,
            "a match among others must give the same as alone",
        )
    expect(
        verifier.verify(query, []) == []
        and verifier.verify(query, [], T_match_query=np.empty((0, 4, 4))) == [],
        "without matches the answer must be empty",
    )


def _prepare(verifier: Verifier, frame: DepthFrame) -> Any:
    return verifier.prepare(frame, points_camera(frame, CLOUD))


def _verify(verifier: Verifier, query: Any, match: Any, guess: Array | None) -> Verification:
    guesses = None if guess is None else guess[None]
    found = verifier.verify(query, [match], T_match_query=guesses)
    expect(len(found) == 1, f"one match must give one answer, got {len(found)}")
    expect_rigid(found[0].T_match_query, "T_match_query")
    information = found[0].information
    expect(information.shape == (6, 6), f"information must be (6, 6), got {information.shape}")
    expect(
        bool(np.isfinite(information).all())
        and bool(np.allclose(information, information.T, rtol=1e-6, atol=1e-6)),
        "information must be finite and symmetric",
    )
    return found[0]
