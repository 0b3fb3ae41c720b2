"""One line for what pydantic has to say about parameters."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

__all__ = ["describe_error", "suggest"]


def describe_error(error: ValidationError, model: type[BaseModel]) -> str:
    """Say which key is wrong, what was found and what was expected.

    Parameters
    ----------
    error
        What validating ``model`` raised; only its first complaint is told.
    model
        Whose keys are known, for a hint at the nearest to one that is not.

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
    key = ".".join(path)
    if first["type"] == "extra_forbidden":
        return f"unknown key {key!r}; {suggest(path[-1], _keys(model, path[:-1]))}"
    if first["type"] == "missing":
        return f"key {key!r}: found none, expected one"
    message = first["msg"].removeprefix("Value error, ")
    expected = message[:1].lower() + message[1:]
    return f"key {key!r}: found {first['input']!r}, {expected}" if key else expected


def suggest(word: str, known: Sequence[str]) -> str:
    """Ask whether the nearest known word was meant or, if none is near, list them all.

    >>> suggest("indor", ["indoor", "paper"])
    "did you mean 'indoor'?"
    """
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known) or 'none'}"


def _keys(model: Any, path: Sequence[str]) -> list[str]:
    """Return the keys that a model has where ``path`` leads."""
    for part in path:
        field = model.model_fields.get(part)
        model = field.annotation if field else None
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return []
    return list(model.model_fields)
