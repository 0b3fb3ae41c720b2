"""The base class of all parameters."""

from __future__ import annotations

from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, model_validator

__all__ = ["Params"]


MAX_COUNT = 1_000_000
"""Largest plausible count; a larger one would only fail after a long time."""
MAX_NUMBER = 1e9
"""Largest plausible number in any unit."""
MAX_SEED = 2**32 - 1
"""Largest seed of scikit-learn."""


class Params(BaseModel):
    """Base class of all parameters.

    They are frozen. An unknown key, a number that is not finite or above 1e9, and a count of more
    than a million are errors.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

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

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        for name, value in self:
            for number in value if isinstance(value, tuple) else (value,):
                if not isinstance(number, int | float):
                    continue
                limit = MAX_COUNT if isinstance(number, int) else MAX_NUMBER
                limit = MAX_SEED if name == "seed" else limit
                if abs(number) > limit:
                    raise ValueError(f"{name} must be at most {limit:.10g}, got {str(number)[:20]}")
        return self
