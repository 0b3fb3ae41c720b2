"""Failures that must not take other results with them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["keep_going"]

logger = logging.getLogger(__name__)


@contextmanager
def keep_going(result: str, warn: Callable[[str], None]) -> Iterator[None]:
    """Warn instead of failing where a result cannot be computed that the rest does not need.

    The run behind it may have taken hours. The traceback goes to the log; errors of the file
    system are raised.
    """
    try:
        yield
    except OSError:
        raise
    except Exception as error:
        logger.exception(result)
        warn(f"{result} could not be computed and is left out ({error!r}); see run.log")
