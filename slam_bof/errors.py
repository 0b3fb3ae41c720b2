"""All errors that a user can correct, with one base class, and the warning of doubtful frames.

Each message is one line that names the file or key, what was found and what was expected. A bad
argument to a function raises a plain ``ValueError`` instead.
"""

__all__ = [
    "AtlasError",
    "ConfigError",
    "DatasetError",
    "FrameError",
    "FrameWarning",
    "MapError",
    "ModelError",
    "PluginError",
    "RunError",
    "SlamBofError",
]


MAX_MESSAGE = 900
"""Characters of a message, of which a third is left for its end."""


class SlamBofError(Exception):
    """Base class of all errors that the user can correct.

    What a message names may come from a file, such as the topics of a bag. A long one is cut in its
    middle, so that it keeps the file at its beginning and what was expected at its end.
    """

    def __str__(self) -> str:
        """Return the message."""
        text = super().__str__()
        if len(text) <= MAX_MESSAGE:
            return text
        end = MAX_MESSAGE // 3
        return f"{text[: MAX_MESSAGE - end]} ... {text[-end:]}"


class AtlasError(SlamBofError):
    """An atlas is missing, locked, damaged or of an unsupported version."""


class ConfigError(SlamBofError):
    """A configuration file, key or value is invalid."""


class DatasetError(SlamBofError):
    """A sequence or one of its files is missing or malformed."""


class FrameError(SlamBofError, ValueError):
    """A frame that cannot be processed: by its time, its camera or its pose. The next one may."""


class FrameWarning(UserWarning):
    """Frames that are processed, but are probably not what they are taken for."""


class ModelError(SlamBofError):
    """A model file is missing, damaged or of an unsupported version."""


class MapError(SlamBofError):
    """A map.db is missing, locked, damaged or of an unsupported version."""


class PluginError(SlamBofError):
    """A plug-in is unknown, or its library is not installed."""


class RunError(SlamBofError):
    """The folder of a run cannot be created, written or read."""
