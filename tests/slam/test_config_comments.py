"""``slam-bof config`` explains every parameter, and what it prints can be read back."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import yaml
from pydantic import BaseModel
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.slam import Config, config, describe_parameters, dump_with_comments


def plugin_params() -> Iterator[tuple[str, type[BaseModel]]]:
    """The parameters of the plug-ins that come with slam_bof."""
    for item in registry.listing():
        if item.target.startswith("slam_bof_plugins") and not registry.missing(item):
            params = getattr(registry.load(item.port, item.name), "Params", None)
            if params is not None:
                yield f"{item.port}.{item.name}.", params


def parameters() -> Iterator[tuple[str, str, str]]:
    """Section, path and description of every parameter."""
    for path, description, _ in describe_parameters(Config):
        yield path.split(".")[0], path, description
    for prefix, params in plugin_params():
        for path, description, _ in describe_parameters(params, prefix):
            yield f"{prefix.split('.')[0]} plug-ins", path, description


def is_sentence(text: str) -> bool:
    return text[:1].isupper() and text.endswith(".") and ".." not in text


def test_every_description_is_a_sentence() -> None:
    wrong = [f"{path}: {text!r}" for _, path, text in parameters() if not is_sentence(text)]
    assert wrong == []


@pytest.mark.parametrize("name", config.presets())
def test_the_comments_change_nothing(name: str) -> None:
    chosen = config.complete(config.preset(name))
    text = dump_with_comments(chosen)
    assert config.parse(text, name) == chosen
    assert yaml.safe_load(text) == yaml.safe_load(config.dump(chosen))


def test_a_configuration_whose_plugins_are_not_completed() -> None:
    chosen = config.override(Config(), ["backend.options.cauchy=2", "odometry=mine"])
    assert config.parse(dump_with_comments(chosen), "x").odometry == chosen.odometry


def test_unit_range_and_choices_are_said() -> None:
    text = dump_with_comments(config.complete(Config()))
    lines = [line.strip() for line in text.splitlines()]
    seed = lines.index("seed: 0")
    assert lines[seed - 1] == "# Seed of everything random in a run. Range: >= 0."
    voxel = next(k for k, line in enumerate(lines) if line.startswith("voxel_size_m: "))
    assert lines[voxel - 1].endswith("Unit: m. Range: > 0.")
    policy = next(k for k, line in enumerate(lines) if line.startswith("policy: "))
    assert "Choices: " in " ".join(lines[policy - 3 : policy])
    assert max(map(len, text.splitlines())) <= 100


def test_a_ratio_of_two_units_is_said() -> None:
    limits = {path: text for path, _, text in describe_parameters(Config)}
    assert limits["verification.drift_m_per_m"].startswith("Unit: m/m.")
    assert limits["verification.drift_rad_per_m"].startswith("Unit: rad/m.")


def test_the_command_prints_the_comments_and_loads_them_again(tmp_path) -> None:
    printed = CliRunner().invoke(app, ["config", "paper"])
    assert printed.exit_code == 0, printed.output
    file = tmp_path / "mine.yaml"
    file.write_text(printed.stdout, encoding="utf-8")
    again = CliRunner().invoke(app, ["config", str(file)])
    assert again.stdout == printed.stdout
    assert config.load(file) == config.complete(config.preset("paper"))
