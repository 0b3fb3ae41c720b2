"""Text of others for a terminal: names of files, and what a foreign map holds."""

from __future__ import annotations

__all__ = ["escape", "one_line"]

MAX_LINE = 2000
"""Characters of an error or a warning."""


def escape(text: str) -> str:
    r"""Return a text with escapes in place of control characters, except ends of lines.

    >>> print(escape("\x1b[31mred"))
    \x1b[31mred
    """
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


def one_line(text: str) -> str:
    r"""Return a text in one line of a moderate length, without control characters.

    >>> one_line("two\r\nlines")
    'two lines'
    """
    return escape(" ".join(text.split()))[:MAX_LINE]
