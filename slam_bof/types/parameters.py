"""The base class of all parameters."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, model_validator

__all__ = ["Params"]


class Params(BaseModel):
    """Base class of all parameters. They are frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    keeps_own_defaults: ClassVar[bool] = False
    """Whether an enclosing model leaves the missing keys to the defaults of this class itself."""

    @model_validator(mode="before")
    @classmethod
    def _keep_nested_defaults(cls, given: Any) -> Any:
        """Complete nested parameters that are given in part with the defaults *of this class*.

        Alignment has other defaults in tracking than in verification. A file that sets one
        number of either must not change the others.
        """
        if not isinstance(given, dict):
            return given
        completed = {
            name: {**field.default.model_dump(), **given[name]}
            for name, field in cls.model_fields.items()
            if isinstance(given.get(name), dict)
            and isinstance(field.default, Params)
            and not field.default.keeps_own_defaults
        }
        return {**given, **completed}
