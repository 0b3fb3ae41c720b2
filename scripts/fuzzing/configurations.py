"""Configurations, of files, of maps and of the command line."""

from __future__ import annotations

import random
from pathlib import Path

from fuzzing.cases import Reader, expect_numbers, quiet
from fuzzing.mutations import mutate_text
from slam_bof.slam import config as configs

__all__ = ["READERS"]


def prepare_config(place: Path) -> None:
    """Write all parameters."""
    text = configs.dump(configs.complete(configs.preset("indoor")))
    (place / "config.yaml").write_text(text)


def mutate_config(place: Path, case: Path, rng: random.Random) -> None:
    """Change the text of a configuration."""
    text = (place / "config.yaml").read_text()
    if rng.random() < 0.1:
        anchors = "".join(f"x{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
        text = f"x0: &a0 [x]\n{anchors}" + text
    for _ in range(rng.choice((1, 1, 2))):
        text = mutate_text(text, rng)
    (case / "config.yaml").write_bytes(text.encode(errors="surrogateescape"))


def read_config(place: Path, case: Path) -> None:
    """Read a configuration in each way."""
    path = case / "config.yaml"
    text = path.read_bytes().decode(errors="replace")
    quiet(lambda: configs.parse_saved(text, "map.db"))
    quiet(
        lambda: configs.override(
            configs.Config(), [line.replace(": ", "=") for line in text.splitlines()[:9]]
        )
    )
    config = configs.complete(configs.load(path))
    expect_numbers(config.model_dump(), "config")


READERS = {"config": Reader(6, prepare_config, mutate_config, read_config)}
