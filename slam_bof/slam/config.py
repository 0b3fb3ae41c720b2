"""The configuration of a run: the parameters of all modules in one model, read from YAML."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import yaml
from pydantic import Field, ValidationError, field_validator

from slam_bof.core import describe_error, parse_yaml, read_text, registry, suggest
from slam_bof.errors import ConfigError
from slam_bof.geometry import PointParams, VirtualCameraParams
from slam_bof.loops import CovisibilityParams, LoopParams, VerificationParams
from slam_bof.scenes import RoomSegmentationParams, SceneFilterParams
from slam_bof.slam.keyframe_culling import MapParams
from slam_bof.tracking import KeyframeParams, TrackingParams
from slam_bof.types import Params, SensorParams

__all__ = [
    "Config",
    "PluginChoice",
    "complete",
    "dump",
    "load",
    "override",
    "parse",
    "parse_saved",
    "preset",
    "presets",
    "resolve",
]

_PACKAGE = Path(__file__).parents[1]
PRESETS = _PACKAGE / "configs"  # in a wheel
if not PRESETS.is_dir():
    PRESETS = _PACKAGE.parent / "configs"  # in a checkout

MAX_BYTES = 1_000_000
"""Largest file that is read."""

PORTS_OF_KEYS = {
    "dataset": "datasets",
    "odometry": "odometry",
    "verifier": "verifiers",
    "backend": "backends",
}
"""The port of the plug-in that each key of the configuration selects."""

RENAMED_KEYS = {
    "tracking.less": "max_inlier_drop",
    "tracking.less_found": "max_inlier_drop_relocalised",
    "tracking.min_compared": "min_visible_ratio",
    "tracking.min_compared_found": "min_visible_ratio_relocalised",
    "tracking.min_pixels": "min_valid_pixel_ratio",
    "alignment.rest": "min_step",
    "alignment.n_last_iterations": "n_final_iterations",
    "keyframes.min_seen": "min_inlier_ratio",
    "loops.min_seen": "min_inlier_ratio",
    "loops.repeat_m": "revisit_distance_m",
    "loops.repeat_rad": "revisit_angle_rad",
    "recogniser.enough": "overlap_saturation",
    "verification.slack_m": "max_correction_m",
    "verification.slack_rad": "max_correction_rad",
    "verification.joining": "component_joining",
    "component_joining.look_about_rad": "min_view_spread_rad",
    "component_joining.walk_about_m": "min_position_spread_m",
    "component_joining.near_m": "max_pair_distance_m",
    "component_joining.near_rad": "max_pair_angle_rad",
    "component_joining.n_compared": "n_pairs",
    "component_joining.max_blocking": "max_free_space_violation",
    "options.max_blocking": "max_free_space_violation",
    "labels.stay_s": "mean_stay_s",
    "labels.stay_m": "mean_stay_m",
    "labels.evidence": "evidence_exponent",
    "labels.smoothing_evidence": "smoothing_evidence_exponent",
    "labels.ahead_m": "look_ahead_m",
    "regions": "rooms",
}
"""Keys of earlier versions, given by the end of their path, and their present names."""
REMOVED_KEYS = (
    "labels.new_view_weight",
    "recogniser.n_plans",
    "recogniser.plan_weight",
    "search.by",
    "search.n_voted",
    "search.constellation_weight",
    "search.index",
    "matching.min_score_ratio",
    "tracking.spread_search",
    "tracking.alignment_sigma_rad",
    "tracking.alignment_sigma_m",
)
"""Keys of earlier versions that a saved map may still have, given by the end of their path."""


class PluginChoice(Params):
    """The name of a plug-in and its options. In YAML a name alone is accepted."""

    keeps_own_defaults: ClassVar[bool] = True  # default options belong to the default plug-in alone

    name: str = Field(description="Name of the plug-in, as slam-bof plugins lists it.")
    options: dict[str, Any] = Field(
        default_factory=dict, description="Options of this plug-in; others have other options."
    )


class Config(Params):
    """All parameters of a run."""

    model: str = Field(
        "default",
        description='Model file, or "default" or "synthetic" for one of those in the package.',
    )
    seed: int = Field(0, ge=0, description="Seed of everything random in a run.")
    dataset: PluginChoice = Field(
        PluginChoice(name="auto"),
        description="Plug-in that reads the sequence; auto recognises the layout of the folder.",
    )
    odometry: PluginChoice = Field(
        PluginChoice(name="kiss-icp"), description="Plug-in that estimates odometry."
    )
    verifier: PluginChoice = Field(
        PluginChoice(name="projective"),
        description="Plug-in that registers the two keyframes of a loop candidate.",
    )
    backend: PluginChoice = Field(
        PluginChoice(name="gtsam"), description="Plug-in that optimises the pose graph."
    )
    sensor: SensorParams = SensorParams()
    virtual_camera: VirtualCameraParams = VirtualCameraParams()
    tracking: TrackingParams = TrackingParams()
    keyframes: KeyframeParams = KeyframeParams()
    labels: SceneFilterParams = SceneFilterParams()
    rooms: RoomSegmentationParams = RoomSegmentationParams()
    loops: LoopParams = LoopParams()
    covisibility: CovisibilityParams = CovisibilityParams()
    verification: VerificationParams = VerificationParams()
    map: MapParams = MapParams()
    gravity_odom: tuple[float, float, float] = Field(
        (0.0, 1.0, 0.0),
        description="Direction of gravity in the odometry frame. The default is right if the "
        "first camera is level.",
    )
    groundtruth_offset_s: float = Field(
        0.0,
        description="Time that is added to the time stamps of true poses before errors are "
        "measured by them, if their clock differs from that of the depth images.",
    )
    cloud: PointParams = Field(
        PointParams(stride=4, max_range_m=4.0),
        description="Point clouds for proximity candidates and for verifiers of point clouds.",
    )

    @field_validator("dataset", "odometry", "verifier", "backend", mode="before")
    @classmethod
    def _accept_name(cls, value: Any) -> Any:
        return {"name": value} if isinstance(value, str) else value


def load(path: Path | str) -> Config:
    """Read a YAML file; missing keys keep their defaults.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not YAML, a key is unknown or a value is invalid.
    """
    path = Path(path)
    try:
        text = read_text(path, max_bytes=MAX_BYTES)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file, expected a YAML configuration") from None
    except OSError as error:
        raise ConfigError(
            f"{path}: found {error.strerror}, expected a YAML configuration"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a YAML file: {error}") from error
    return parse(text, str(path))


def parse(text: str, where: str) -> Config:
    """Return the configuration in a YAML text; ``where`` names it in a ``ConfigError``."""
    return _validate(_read_yaml(text, where), where)


def parse_saved(text: str, where: str) -> Config:
    """Return the configuration that a saved map keeps, as ``parse`` does.

    Keys of earlier versions, which ``parse`` refuses, are replaced by their present names, or left
    out if nothing came of them.
    """
    return _validate(_upgrade(_read_yaml(text, where)), where)


def _read_yaml(text: str, where: str) -> Any:
    try:
        values = parse_yaml(text)
    except ValueError as error:
        raise ConfigError(f"{where}: not a YAML file: {error}") from error
    return {} if values is None else values


def presets() -> list[str]:
    """Return the names of the configurations in the package."""
    return sorted(file.stem for file in PRESETS.glob("*.yaml"))


def preset(name: str) -> Config:
    """Return a configuration of the package by name; raise ``ConfigError`` if unknown."""
    if name not in presets():
        raise ConfigError(f"no preset {name!r}; {suggest(name, presets())}")
    return load(PRESETS / f"{name}.yaml")


def resolve(name: str) -> Config:
    """Return the preset of that name, or else the configuration in the file of that name."""
    if name in presets():
        return preset(name)
    if Path(name).suffix in (".yaml", ".yml") or Path(name).exists():
        return load(name)
    return preset(name)


def dump(config: Config) -> str:
    """Return a configuration as YAML, defaults included. ``load`` restores it."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def override(config: Config, assignments: Iterable[str]) -> Config:
    """Return the configuration after assignments ``key.sub=value``, whose values are YAML.

    >>> override(Config(), ["loops.top_k=3", "odometry=open3d"]).odometry.name
    'open3d'
    """
    values = config.model_dump()
    for assignment in assignments:
        key, separator, text = assignment.partition("=")
        if not separator or not key.strip():
            raise ConfigError(f"found {assignment!r}, expected KEY=VALUE, such as loops.top_k=3")
        try:
            value = parse_yaml(text)
        except ValueError as error:
            raise ConfigError(f"--set {key}: {text[:80]!r} is not a YAML value: {error}") from error
        _assign(values, key.strip().split("."), value)
    return _validate(values, "--set")


def complete(config: Config) -> Config:
    """Return the configuration with every option of its plug-ins written out.

    Plug-ins are loaded and their options are validated, which reading a file alone does not do.
    Errors are those of ``registry.check_options``.
    """
    choices = {}
    for key, port in PORTS_OF_KEYS.items():
        choice: PluginChoice = getattr(config, key)
        if port == "datasets" and choice.name == "auto":
            continue  # the plug-in is unknown until there is a folder to recognise
        params = registry.check_options(port, choice.name, choice.options)
        options = params.model_dump(mode="json") if params else {}
        choices[key] = PluginChoice(name=choice.name, options=options)
    return config.model_copy(update=choices)


def _validate(values: Any, where: str) -> Config:
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where}: found a {type(values).__name__}, expected keys and values")
    for key, name in _renamed_keys(values):
        raise ConfigError(f"{where}: unknown key {key!r}; its name is now {name!r}")
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{where}: {describe_error(error, Config)}") from error


def _renamed_keys(values: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path of each key of an earlier version, and its present name."""
    if not isinstance(values, Mapping):
        return
    for key, value in values.items():
        place = f"{path}.{key}"
        if new := next((n for old, n in RENAMED_KEYS.items() if place.endswith(f".{old}")), None):
            yield place[1:], new
        yield from _renamed_keys(value, place)


def _upgrade(values: Any, path: str = "") -> Any:
    """Return the values with keys of earlier versions renamed or removed."""
    if not isinstance(values, Mapping):
        return values
    upgraded = {}
    for key, value in values.items():
        place = f"{path}.{key}"
        if place.endswith(tuple(f".{removed}" for removed in REMOVED_KEYS)):
            continue
        new = next((n for old, n in RENAMED_KEYS.items() if place.endswith(f".{old}")), key)
        upgraded[new] = _upgrade(value, f"{path}.{new}")
    return upgraded


def _assign(values: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        # A missing key is created, so that validation reports it.
        child = values.setdefault(part, {})
        if not isinstance(child, dict):
            raise ConfigError(f"--set: key {'.'.join(path)!r}: {part!r} has no keys below it")
        values = child
    values[path[-1]] = value
