"""YAML of unknown origin, within bounds: a few lines may expand to gigabytes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml

__all__ = ["parse_yaml"]

MAX_CHARACTERS = 1_000_000
MAX_DEPTH = 20
MAX_SCALAR = 3000
"""Characters of one value. Python prints integers of up to 4300 digits."""


SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The loader in C if PyYAML has one, which is ten times as fast."""


class _Loader(SafeLoader):  # type: ignore[misc]
    """Refuses a key that is given twice, of which YAML libraries take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.YAMLError(f"a key that is no text, {_place(key)}")
            if key.value in seen:
                raise yaml.YAMLError(f"key {key.value[:80]!r} is given twice, {_place(key)}")
            seen.add(key.value)
        values: dict[Any, Any] = super().construct_mapping(node, deep)
        return values


def parse_yaml(text: str) -> Any:
    r"""Return the value of a YAML text of moderate size.

    >>> parse_yaml("a: 1\na: 2")
    Traceback (most recent call last):
    ValueError: key 'a' is given twice, line 2

    Raises
    ------
    ValueError
        In one line, if it is no YAML, repeats a key, has aliases or types, or is too much of one.
    """
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"found {len(text)} characters, expected {MAX_CHARACTERS} at most")
    try:
        for wrong in _excesses(text):
            raise ValueError(wrong)
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(" ".join(str(error).split())[:300]) from None


def _excesses(text: str) -> Iterator[str]:
    """Yield what is too much of a text, before any value of it is made."""
    depth = 0
    for event in yaml.parse(text, SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            yield f"an alias is not supported, {_place(event)}"
        elif tag := getattr(event, "tag", None):
            yield f"a type ({tag[:40]}) is not supported, {_place(event)}"
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_SCALAR:
            yield f"a value of {len(event.value)} characters, {_place(event)}"
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            yield f"more than {MAX_DEPTH} levels, {_place(event)}"


def _place(item: Any) -> str:
    return f"line {item.start_mark.line + 1}"
