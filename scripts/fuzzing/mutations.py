"""Seeded mutations of files, for ``scripts/fuzz``."""

from __future__ import annotations

import io
import random
import re
import struct
from typing import Any

import numpy as np

__all__ = ["mutate_array", "mutate_bytes", "mutate_json", "mutate_text", "strange_value"]

NUMBERS = (
    "nan", "inf", "-inf", "1e999", "-1", "0", "1e-320", "1e38", "9" * 30, "9" * 5000, "-0.0",
    "0x10", "1_000", "\u0663", "1e", "", "true", "null", '"x"', "[]", "{}", "2147483648",
)  # fmt: skip
TEXTS = (
    "", "\0", "\n", "\x1b[31m", "\u202e", "x" * 9000, "[" * 5000, "../../x", "'", "%s", "\ufeff",
)  # fmt: skip
WORDS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
FLOATS = (np.nan, np.inf, -np.inf, 1e38, -1e38, 1e300, 1e-320, 0.0, -1.0)


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """Flip bits, set bytes, cut, splice, repeat, or write extreme numbers over some."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        if not changed:
            return bytes(changed)
        at, kind = rng.randrange(len(changed)), rng.randrange(9)
        # Headers stand first and directories last.
        if rng.random() < 0.4:
            at = min(at % 200, len(changed) - 1) if rng.random() < 0.6 else -1 - at % 200
            at = at % len(changed)
        length = min(rng.choice((1, 2, 4, 8, 64, 1000)), len(changed) - at)
        if kind < 3:
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 3:
            changed[at] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
        elif kind == 4:
            del changed[at : at + length]
        elif kind == 5:
            changed[at:at] = changed[(start := rng.randrange(len(changed))) : start + length]
        elif kind == 6:
            word = struct.pack(rng.choice("<>") + "Q", rng.choice(WORDS))[: rng.choice((2, 4, 8))]
            changed[at : at + len(word)] = word
        elif kind == 7:
            form = rng.choice(("<f", "<d", ">d"))
            number = rng.choice(FLOATS if form != "<f" else FLOATS[:5])
            word = struct.pack(form, number)
            changed[at : at + len(word)] = word
        else:
            del changed[at:]
    return bytes(changed)


def mutate_text(text: str, rng: random.Random) -> str:
    """Replace a number, a word or a line, or change some bytes."""
    kind = rng.randrange(4)
    if kind == 0 and (found := list(re.finditer(r"-?\d[\d.e+-]*", text))):
        place = rng.choice(found)
        return text[: place.start()] + rng.choice(NUMBERS) + text[place.end() :]
    if kind == 1 and (found := list(re.finditer(r"[A-Za-z_]+", text))):
        place = rng.choice(found)
        return text[: place.start()] + rng.choice((*TEXTS, *NUMBERS)) + text[place.end() :]
    if kind == 2:
        lines = text.splitlines(keepends=True) or [""]
        lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines) + rng.choice(TEXTS))
        if rng.random() < 0.3:
            rng.shuffle(lines)
        return "".join(lines)
    data = text.encode(errors="surrogateescape")
    return mutate_bytes(data, rng).decode(errors="surrogateescape")


def mutate_array(data: bytes, rng: random.Random) -> bytes:
    """Change values, shape or type of an array in .npy format, or its bytes."""
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # it is broken already
        return mutate_bytes(data, rng)
    if not isinstance(array, np.ndarray) or array.dtype.kind == "V":  # trees
        return mutate_bytes(data, rng)
    kind = rng.randrange(5)
    if kind == 0 and array.size and array.dtype.kind in "fiu":
        array = array.copy()
        with np.errstate(all="ignore"):
            value = np.float64(rng.choice((*FLOATS, *map(float, WORDS)))).astype(array.dtype)
        array.flat[rng.randrange(array.size) if rng.random() < 0.7 else slice(None)] = value
    elif kind == 1 and array.ndim:
        array = array[: rng.randrange(len(array) + 1)]
    elif kind == 2:
        kinds = ("<f4", "<f8", "<i4", "<u2", "U3", "?") if array.dtype.kind in "fiu" else ("U3",)
        array = array.astype(rng.choice(kinds), casting="unsafe")
    elif kind == 3:
        array = array.reshape(-1) if rng.random() < 0.5 else array[None]
    else:
        return mutate_bytes(data, rng)
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def mutate_json(value: Any, rng: random.Random) -> Any:
    """Change one value somewhere in a JSON value."""
    if isinstance(value, dict) and value and rng.random() < 0.93:
        key = rng.choice(sorted(value))
        changed = dict(value)
        if rng.random() < 0.05:
            del changed[key]
        else:
            changed[key] = mutate_json(value[key], rng)
        return changed
    if isinstance(value, list) and value and rng.random() < 0.93:
        changed_list = list(value)
        at = rng.randrange(len(value))
        changed_list[at] = mutate_json(value[at], rng)
        return changed_list
    if isinstance(value, str) and rng.random() < 0.4:
        return mutate_text(value, rng).encode(errors="replace").decode()
    return strange_value(rng)


def strange_value(rng: random.Random) -> Any:
    """Return a value of any type that a database or JSON has."""
    numbers = (0, -1, 1, 7, 2**31, 2**62, 1e38, 1e-320, 0.5)
    return rng.choice((None, True, *numbers, "", "x", "nan", "x" * 3000, [], {}))
