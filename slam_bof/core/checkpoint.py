"""Take back what a call did if it does not come to its end."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import is_dataclass
from enum import Enum
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from pydantic import BaseModel

__all__ = ["Checkpoint", "Restorable"]

Restore = Callable[[], None]


@runtime_checkable
class Restorable(Protocol):
    """An object that knows best how to return to its present state."""

    def checkpoint(self) -> Restore:
        """Return a function that restores the present state, as often as it is called."""


class Checkpoint:
    """The state of objects, to return to if what follows fails half-way.

    Attributes, lists, deques, dictionaries and sets are followed and remembered. Arrays, frozen
    records and parameters are not, because they are replaced and never changed in place. Objects
    with a method ``checkpoint`` save themselves.

    >>> class Counter:
    ...     def __init__(self):
    ...         self.n, self.seen = 0, []
    >>> counter = Counter()
    >>> before = Checkpoint()
    >>> before.save(counter)
    >>> counter.n = 1
    >>> counter.seen.append(1)
    >>> before.restore()
    >>> counter.n, counter.seen
    (0, [])
    """

    def __init__(self) -> None:
        self._restores: list[Restore] = []
        self._saved: dict[int, object] = {}  # holds the objects, so that no id is used again

    def save(self, *objects: object) -> None:
        """Remember the state of objects and of all that they hold."""
        pending = _choose_mutable(objects)
        while pending:
            thing = pending.pop()
            if id(thing) in self._saved:
                continue
            self._saved[id(thing)] = thing
            kind = type(thing)
            if kind not in _saves_itself:
                _saves_itself[kind] = isinstance(thing, Restorable)
            if _saves_itself[kind]:
                self._restores.append(cast(Restorable, thing).checkpoint())
                continue
            restore, held = _remember(thing)
            self._restores.append(restore)
            pending.extend(_choose_mutable(held))

    def save_attributes(self, thing: object, *names: str) -> None:
        """Remember only which objects some attributes refer to."""
        values = {name: getattr(thing, name) for name in names}

        def restore() -> None:
            for name, value in values.items():
                setattr(thing, name, value)

        self._restores.append(restore)

    def restore(self) -> None:
        """Return to the remembered state; if interrupted, it may be called again."""
        for restore in self._restores:
            restore()


_saves_itself: dict[type, bool] = {}
"""Whether objects of a type are ``Restorable``, which takes too long to ask of each."""
_kinds: dict[type, bool] = {}


def _choose_mutable(things: Collection[object]) -> list[object]:
    """Return the objects that may change in place; thousands of objects have few types."""
    kinds = {kind for kind in set(map(type, things)) if _is_mutable(kind)}
    return [thing for thing in things if type(thing) in kinds] if kinds else []


def _remember(thing: Any) -> tuple[Restore, Collection[object]]:
    """Return a function that restores one object, and what the object holds."""
    if isinstance(thing, list):
        items = thing.copy()
        return lambda: thing.__setitem__(slice(None), items), _sample(items)
    if isinstance(thing, dict | set | deque):
        copied = thing.copy()
        held = copied.values() if isinstance(copied, dict) else copied
        add = thing.extend if isinstance(thing, deque) else thing.update
        return lambda: (thing.clear(), add(copied))[0], held
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    names = [*getattr(thing, "__dict__", ()), *(name for name in slots if hasattr(thing, name))]
    values = {name: getattr(thing, name) for name in names}

    def restore() -> None:
        for name in [name for name in getattr(thing, "__dict__", ()) if name not in values]:
            delattr(thing, name)
        for name, value in values.items():
            setattr(thing, name, value)

    return restore, values.values()


def _sample(items: list[Any]) -> list[Any]:
    """Return the items of a list if they can change; a list holds objects of one kind."""
    return items if items and _is_mutable(type(items[0])) else []


def _is_mutable(kind: type) -> bool:
    """Return whether objects of a type may change in place."""
    if kind not in _kinds:
        _kinds[kind] = _can_change(kind)
    return _kinds[kind]


def _can_change(kind: type) -> bool:
    if issubclass(kind, list | dict | set | deque):
        return True
    if is_dataclass(kind) and kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return False
    constant = (
        *(bool, int, float, complex, str, bytes, tuple, frozenset, range, type(None)),
        *(type, FunctionType, BuiltinFunctionType, MethodType, ModuleType),
        *(Enum, BaseModel, np.ndarray, np.generic, np.dtype, np.random.Generator),
    )
    has_attributes = "__dict__" in dir(kind) or hasattr(kind, "__slots__")
    return has_attributes and not issubclass(kind, constant)
