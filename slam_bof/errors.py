"""Every error a user can mend, in one tree.

Each message names the file (or key), what was found and what was expected, in
one line. A bad argument to a function is a plain ``ValueError`` instead.
"""

__all__ = [
    "ConfigError",
    "DatasetError",
    "MapError",
    "ModelError",
    "PluginError",
    "RunError",
    "SlamBofError",
]


class SlamBofError(Exception):
    """Base of all errors that the user can mend."""


class ConfigError(SlamBofError):
    """A configuration file, key or value is not what it should be."""


class DatasetError(SlamBofError):
    """A sequence or one of its files is missing or malformed."""


class ModelError(SlamBofError):
    """A model file is missing, of another version, or damaged."""


class MapError(SlamBofError):
    """A map.db is missing, locked, of another version, or damaged."""


class PluginError(SlamBofError):
    """A plug-in is unknown, or its library is not installed."""


class RunError(SlamBofError):
    """A run's folder cannot be made, written or read."""
