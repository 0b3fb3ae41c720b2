"""Configurations that would take all memory, or mean something else than they say."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from slam_bof.errors import ConfigError
from slam_bof.slam import config as configs

BOMB = "seed:\n  - &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"  - &{new} [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
REFUSED = {
    BOMB: "an alias is not supported, line 3",
    "seed: 1\nkeyframes: {every: 1, every: 5}": "key 'every' is given twice, line 2",
    "seed: 1\nseed: 2": "key 'seed' is given twice, line 2",
    "model: 2026-13-45": "month must be in",
    "model: 2026-11-28T99:00:00Z": "hour must be in",
    "seed: " + "[" * 3000: "more than 20 levels, line 1",
    "seed: " + "9" * 5000: "a value of 5000 characters",
    "seed: 0x" + "f" * 2900: "seed must be at most 4294967295",
    "seed: 18446744073709551616": "seed must be at most 4294967295",
    "seed: .nan": "finite",
    "loops: {revisit_distance_m: .inf}": "finite",
    "keyframes: {angle_rad: 1.0e+38}": "angle_rad must be at most 1000000000, got 1e+38",
    "gravity_odom: [0, 1.0e+300, 0]": "gravity_odom must be at most",
    "loops: {top_k: 999999999999}": "top_k must be at most 1000000",
    "seed: !!timestamp 99": "a type",
    "seed: !!python/object:os.system x": "a type",
    "? [1, 2]\n: 3": "a key that is no text, line 1",
    "1: 2": "key",
    "seed: \0": "characters are not allowed",
    f"{'k' * 900}: 1": "unknown key 'kkk",
    "#" * 1_000_001: "found 1000001 characters",
}


@pytest.mark.parametrize("text", REFUSED, ids=[text[:24] for text in REFUSED])
@pytest.mark.parametrize("parse", [configs.parse, configs.parse_saved])
def test_a_hostile_configuration_is_one_short_line(text: str, parse) -> None:
    tracemalloc.start()
    with pytest.raises(ConfigError) as caught:
        parse(text, "my.yaml")
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith("my.yaml: ")
    assert REFUSED[text] in message
    assert "\n" not in message
    assert len(message) < 600
    assert peak_bytes < 20_000_000


@pytest.mark.parametrize("text", ["[" * 3000, "9" * 5000, "2026-13-45", "&a [*a, *a]", "!!set {a}"])
def test_a_hostile_value_on_the_command_line_is_one_short_line(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--set seed: .* is not a YAML value: ") as caught:
        configs.override(configs.Config(), [f"seed={text}"])
    assert len(str(caught.value)) < 400


def test_a_file_that_is_no_text_of_moderate_size_is_not_read(tmp_path: Path) -> None:
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ConfigError, match=r"huge\.yaml: found more than \d+ bytes, expected"):
        configs.load(huge)
