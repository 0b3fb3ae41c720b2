"""What both verifiers are asked alike."""

import numpy as np
import pytest

from slam_bof import se3


def verify(verifier, query, match, guess=None, seed=0):
    """Verify one pair."""
    guesses = None if guess is None else guess[None]
    (verified,) = verifier.verify(query, [match], T_match_query=guesses, seed=seed)
    return verified


def assert_order_is_kept(verifier, query, match, behind, T_match_query):
    """Check that matches verified together come back in order, each as if it were alone."""
    matches = [match, behind]
    guesses = np.stack([T_match_query, se3.pose(np.eye(3), [0.0, 0.0, 20.0])])
    together = verifier.verify(query, matches, T_match_query=guesses)
    assert [v.accepted for v in together] == [True, False]
    for verified, one, guess in zip(together, matches, guesses, strict=True):
        alone = verify(verifier, query, one, guess)
        np.testing.assert_allclose(verified.T_match_query, alone.T_match_query, atol=1e-4)
        assert verified.overlap == pytest.approx(alone.overlap, abs=2e-3)
    assert verifier.verify(query, []) == []
    assert verifier.verify(query, [], T_match_query=np.empty((0, 4, 4))) == []
