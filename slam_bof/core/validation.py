"""One-line messages for the validation errors of pydantic."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

__all__ = ["describe_error", "suggest"]

MAX_SHOWN = 100
"""Characters of a key or value that a message shows."""


def describe_error(error: ValidationError, model: type[BaseModel]) -> str:
    """Return a message that names the wrong key, what was found and what was expected.

    Parameters
    ----------
    error
        The error that validating ``model`` raised. Only its first entry is reported.
    model
        The model. The message for an unknown key suggests the most similar key of it.

    Examples
    --------
    >>> class Colour(BaseModel, extra="forbid"):
    ...     red: float = 0.0
    >>> try:
    ...     Colour.model_validate({"redd": 1})
    ... except ValidationError as error:
    ...     describe_error(error, Colour)
    "unknown key 'redd'; did you mean 'red'?"
    """
    first = error.errors()[0]
    path = tuple(str(part) for part in first["loc"])
    key = ".".join(path)[:MAX_SHOWN]
    if first["type"] == "extra_forbidden":
        return f"unknown key {key!r}; {suggest(path[-1], _keys(model, path[:-1]))}"
    if first["type"] == "missing":
        return f"key {key!r}: found none, expected one"
    message = first["msg"].removeprefix("Value error, ")[: 3 * MAX_SHOWN]
    expected = message[:1].lower() + message[1:]
    return f"key {key!r}: found {repr(first['input'])[:MAX_SHOWN]}, {expected}" if key else expected


def suggest(word: str, known: Sequence[str]) -> str:
    """Suggest the most similar known word, or list all known words if none is similar.

    >>> suggest("indor", ["indoor", "paper"])
    "did you mean 'indoor'?"
    """
    similar = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {similar[0]!r}?" if similar else f"known: {', '.join(known) or 'none'}"


def _keys(model: Any, path: Sequence[str]) -> list[str]:
    """Return the keys of the nested model at ``path``."""
    for part in path:
        field = model.model_fields.get(part)
        model = field.annotation if field else None
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return []
    return list(model.model_fields)
