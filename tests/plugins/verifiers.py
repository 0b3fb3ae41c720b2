"""What both verifiers are asked alike."""


def verify(verifier, query, match, guess=None, seed=0):
    """Verify one pair."""
    guesses = None if guess is None else guess[None]
    (verified,) = verifier.verify(query, [match], T_match_query=guesses, seed=seed)
    return verified
