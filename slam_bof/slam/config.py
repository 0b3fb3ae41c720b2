"""All parameters of a run as one tree, composed of the parts' own; YAML in and out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import yaml
from pydantic import Field, ValidationError, field_validator

from slam_bof.core import describe_error, registry, suggest
from slam_bof.errors import ConfigError
from slam_bof.geometry import PointParams
from slam_bof.loops import CovisibilityParams, LoopParams, VerificationParams
from slam_bof.scenes import RegionParams, SceneFilterParams
from slam_bof.tracking import KeyframeParams, TrackingParams
from slam_bof.types import Params

__all__ = [
    "Config",
    "PluginChoice",
    "complete",
    "dump",
    "load",
    "override",
    "parse",
    "preset",
    "presets",
    "resolve",
]

_PACKAGE = Path(__file__).parents[1]
PRESETS = _PACKAGE / "configs"  # in a wheel
if not PRESETS.is_dir():
    PRESETS = _PACKAGE.parent / "configs"  # in a checkout

PORTS_OF_KEYS = {
    "dataset": "datasets",
    "odometry": "odometry",
    "verifier": "verifiers",
    "backend": "backends",
}
"""Which port a key of the configuration chooses the plug-in of."""


class PluginChoice(Params):
    """A plug-in by name, with its options; a bare name will do in YAML."""

    given_whole: ClassVar[bool] = True  # options of one plug-in are none of another's

    name: str
    options: dict[str, Any] = Field(default_factory=dict)


class Config(Params):
    """Everything that, with a sequence, determines a run."""

    model: str = Field("default", description="the model that comes along, or a file")
    seed: int = Field(0, ge=0)
    dataset: PluginChoice = Field(
        PluginChoice(name="auto"), description="a data-set plug-in; auto looks at the folder"
    )
    odometry: PluginChoice = PluginChoice(name="kiss-icp")
    verifier: PluginChoice = PluginChoice(name="projective")
    backend: PluginChoice = PluginChoice(name="gtsam")
    tracking: TrackingParams = TrackingParams()
    keyframes: KeyframeParams = KeyframeParams()
    labels: SceneFilterParams = SceneFilterParams()
    regions: RegionParams = RegionParams()
    loops: LoopParams = LoopParams()
    covisibility: CovisibilityParams = CovisibilityParams()
    verification: VerificationParams = VerificationParams()
    gravity_odom: tuple[float, float, float] = Field(
        (0.0, 1.0, 0.0),
        description="down in the odometry's frame, for a model with layers along gravity; "
        "by default the first camera is taken as level",
    )
    cloud: PointParams = Field(
        PointParams(stride=4, max_range_m=4.0),
        description="what proximity and verifiers of clouds see",
    )

    @field_validator("dataset", "odometry", "verifier", "backend", mode="before")
    @classmethod
    def _accept_name(cls, value: Any) -> Any:
        return {"name": value} if isinstance(value, str) else value


def load(path: Path | str) -> Config:
    """Read a YAML file; what it leaves out keeps its default.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no YAML, or a key or value is not known.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file, expected a YAML configuration") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a YAML file: {error}") from error
    return parse(text, str(path))


def parse(text: str, where: str) -> Config:
    """Return the configuration that YAML text has; ``where`` names it in a ``ConfigError``."""
    try:
        values = yaml.safe_load(text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{where}: not a YAML file: {reason}") from error
    return _validate({} if values is None else values, where)


def presets() -> list[str]:
    """Return the names of the configurations that come along."""
    return sorted(file.stem for file in PRESETS.glob("*.yaml"))


def preset(name: str) -> Config:
    """Return a configuration that comes along, by name; ``ConfigError`` if there is none."""
    if name not in presets():
        raise ConfigError(f"no preset {name!r}; {suggest(name, presets())}")
    return load(PRESETS / f"{name}.yaml")


def resolve(name: str) -> Config:
    """Return a preset by its name, or else the configuration in the file of that name."""
    if name in presets():
        return preset(name)
    if Path(name).suffix in (".yaml", ".yml") or Path(name).exists():
        return load(name)
    return preset(name)


def dump(config: Config) -> str:
    """Return a configuration as YAML, defaults included; ``load`` gives the same back."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def override(config: Config, assignments: Iterable[str]) -> Config:
    """Return the configuration with ``key.sub=value`` assignments made; values are YAML.

    >>> override(Config(), ["loops.top_k=3", "odometry=open3d"]).odometry.name
    'open3d'
    """
    values = config.model_dump()
    for assignment in assignments:
        key, separator, text = assignment.partition("=")
        if not separator or not key.strip():
            raise ConfigError(f"found {assignment!r}, expected KEY=VALUE, such as loops.top_k=3")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ConfigError(f"{assignment!r}: {text!r} is not a YAML value") from error
        _assign(values, key.strip().split("."), value)
    return _validate(values, "--set")


def complete(config: Config) -> Config:
    """Return the configuration with every option of its plug-ins written out.

    Loads the plug-ins and checks their options, which reading a file alone does not; raises as
    ``registry.check_options``.
    """
    choices = {}
    for key, port in PORTS_OF_KEYS.items():
        choice: PluginChoice = getattr(config, key)
        if port == "datasets" and choice.name == "auto":
            continue  # whose options these are is known only when there is a folder to look at
        params = registry.check_options(port, choice.name, choice.options)
        options = params.model_dump(mode="json") if params else {}
        choices[key] = PluginChoice(name=choice.name, options=options)
    return config.model_copy(update=choices)


def _validate(values: Any, where: str) -> Config:
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where}: found a {type(values).__name__}, expected keys and values")
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{where}: {describe_error(error, Config)}") from error


def _assign(values: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        # A key that is not there is made, so that validation can name it.
        child = values.setdefault(part, {})
        if not isinstance(child, dict):
            raise ConfigError(f"--set: key {'.'.join(path)!r}: {part!r} has no keys below it")
        values = child
    values[path[-1]] = value
