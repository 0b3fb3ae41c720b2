"""Ctrl-C is told from faults of C code."""

import pytest

from slam_bof.core import unwrap_interruption


def caused_by(cause: BaseException) -> SystemError:
    """Return the error that CPython makes of an exception that a C function has overlooked."""
    error = SystemError("<built-in function f> returned a result with an exception set")
    error.__cause__ = cause
    return error


def test_an_interruption_in_c_code_is_one():
    with pytest.raises(KeyboardInterrupt), unwrap_interruption():
        raise caused_by(caused_by(KeyboardInterrupt()))


def test_a_fault_of_c_code_stays_one():
    with pytest.raises(SystemError, match="exception set"), unwrap_interruption():
        raise caused_by(ValueError("a fault"))


def test_an_interruption_stays_one():
    with pytest.raises(KeyboardInterrupt), unwrap_interruption():
        raise KeyboardInterrupt
