"""A configuration as YAML with a comment on every parameter: description, unit and range."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from slam_bof.core import registry
from slam_bof.slam.config import PORTS_OF_KEYS, Config

__all__ = ["describe_parameters", "dump_with_comments", "unit_of"]

WIDTH = 100
INDENT = "  "
UNITS = {"m": "m", "s": "s", "ms": "ms", "rad": "rad", "deg": "degrees", "px": "pixels"}
"""Units by the suffix of a parameter's name."""
BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}

Model = type[BaseModel]


def dump_with_comments(config: Config) -> str:
    """Return a configuration as YAML that explains itself; ``load`` gives the same back.

    Options of plug-ins are explained as far as ``complete`` has written them out.
    """
    options: dict[str, Model] = {}
    for key, port in PORTS_OF_KEYS.items():
        choice = getattr(config, key)
        if choice.options:
            params = registry.check_options(port, choice.name, choice.options)
            if params is not None:
                options[key] = type(params)
    lines = _lines(config.model_dump(mode="json"), Config, options, "")
    return "".join(f"{line}\n" for line in lines)


def describe_parameters(model: Model, path: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield path, description, and unit and range of every section and parameter of a model.

    Examples
    --------
    >>> path, description, limits = next(describe_parameters(Config))
    >>> path, description
    ('model', 'Model file, or "default" or "synthetic" for one of those in the package.')
    >>> {path: limits for path, _, limits in describe_parameters(Config)}["seed"]
    'Range: >= 0.'
    """
    for name, field in model.model_fields.items():
        yield f"{path}{name}", _description(field), _limits(name, field)
        if (section := _section(field)) is not None:
            yield from describe_parameters(section, f"{path}{name}.")


def unit_of(name: str) -> str:
    """Return the unit that a parameter's name ends in; empty if it ends in none.

    >>> unit_of("drift_rad_per_m"), unit_of("n_points")
    ('rad/m', '')
    """
    stem, _, suffix = name.rpartition("_")
    if not stem or suffix not in UNITS:
        return ""
    if stem.endswith("_per"):
        numerator = UNITS.get(stem.removesuffix("_per").rpartition("_")[2], "1")
        return f"{numerator}/{UNITS[suffix]}"
    return UNITS[suffix]


def _lines(
    values: Mapping[str, Any], model: Model | None, options: Mapping[str, Model], indent: str
) -> Iterator[str]:
    """Yield the lines of a section; ``options`` are the models of plug-ins' options, by key."""
    for name, value in values.items():
        field = None if model is None else model.model_fields.get(name)
        if field is not None:
            yield from _comment(name, field, indent)
        section = options.get(name) if field is None or name == "options" else _section(field)
        inner = options
        if not indent and name in PORTS_OF_KEYS:
            inner = {"options": options[name]} if name in options else {}
        if isinstance(value, dict) and value and (section is not None or name == "options"):
            yield f"{indent}{name}:"
            yield from _lines(value, section, inner, indent + INDENT)
        else:
            text = yaml.safe_dump({name: value}, sort_keys=False, allow_unicode=True)
            yield from (indent + line for line in text.splitlines())


def _comment(name: str, field: FieldInfo, indent: str) -> Iterator[str]:
    text = " ".join(part for part in (_description(field), _limits(name, field)) if part)
    for line in textwrap.wrap(text, WIDTH - len(indent) - 2, break_on_hyphens=False):
        yield f"{indent}# {line}"


def _description(field: FieldInfo) -> str:
    """Return a parameter's description; a section without one has that of its model."""
    if field.description:
        return field.description
    section = _section(field)
    return "" if section is None else (inspect.getdoc(section) or "").splitlines()[0]


def _limits(name: str, field: FieldInfo) -> str:
    """Return unit, range and choices of a parameter, where it has them."""
    found = []
    if unit := unit_of(name):
        found.append(f"Unit: {unit}.")
    bounds = [
        f"{sign} {getattr(constraint, bound):g}"
        for bound, sign in BOUNDS.items()
        for constraint in field.metadata
        if getattr(constraint, bound, None) is not None
    ]
    if bounds:
        found.append(f"Range: {', '.join(bounds)}.")
    if get_origin(field.annotation) is Literal:
        found.append(f"Choices: {', '.join(map(str, get_args(field.annotation)))}.")
    return " ".join(found)


def _section(field: FieldInfo) -> Model | None:
    """Return the model of a parameter that is a section, also of one that may be null."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None
