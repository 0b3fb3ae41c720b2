"""Parameters of the node: their defaults, and what they may be."""

from __future__ import annotations

from typing import Any

from slam_bof.errors import ConfigError

__all__ = ["PARAMETERS", "check_parameter"]

PARAMETERS: dict[str, Any] = {
    "map_file": "~/.ros/slam_bof/map.db",
    "mode": "mapping",
    "config": "indoor",
    "set": [""],
    "odom_frame": "odom",
    "base_frame": "base_link",
    "map_frame": "map",
    "use_tf": False,
    "use_covariance": True,
    "background": True,
    "input": "depth",
    "compressed": False,
    "rectified": True,
    "tf_rate": 20.0,
    "tf_ahead_s": 0.1,
    "graph_period_s": 2.0,
    "map_period_s": 10.0,
    "max_map_keyframes": 200,
}
CHOICES = {"mode": ("mapping", "localization"), "input": ("depth", "cloud")}


def check_parameter(name: str, value: Any) -> None:
    """Check the value of a parameter, whose type ROS has checked.

    >>> check_parameter("input", "points")
    Traceback (most recent call last):
    slam_bof.errors.ConfigError: parameter input: found 'points', expected depth or cloud

    Raises
    ------
    ConfigError
        If it is none of the choices, or a rate that is not greater than 0.
    """
    choices = CHOICES.get(name)
    if choices is not None and value not in choices:
        raise ConfigError(f"parameter {name}: found {value!r}, expected {' or '.join(choices)}")
    if name == "tf_rate" and not value > 0.0:
        raise ConfigError(f"parameter {name}: found {value:g} Hz, expected more than 0")
