"""Escapes that turn names of models, axes and pins into identifiers for VCD, rerun, C and file names, and back.

An MJCF may call an axis anything: `Achse_ü`, `x 1`, `robot/x`. Characters that a format does not allow are escaped, never dropped,
so that two names never become one, and `unescape_name` restores the name.
"""

from __future__ import annotations

import re
from collections.abc import Container

_INVALID_CHARACTER = re.compile(r"\W|^\d|_(?=u[0-9a-f]+(?:_|\W))", re.ASCII)
_ESCAPE_SEQUENCE = re.compile(r"_u([0-9a-f]+)_")


def escape_name(name: str, reserved: Container[str] = ()) -> str:
    """Convert any name to an identifier: ASCII letters, digits and underscores, not beginning with a digit.

    A name that is an identifier already is returned unchanged. Any other character is replaced by its code point between `_u`
    and `_`: "x 1" becomes "x_u20_1". An underscore that looks like the beginning of such an escape is escaped as well.

    Args:
        name: Any text.
        reserved: Keywords of the format; if the name is one of them, its first letter is escaped.
    """
    word = _INVALID_CHARACTER.sub(lambda match: _escape_character(match[0]), name)
    return _escape_character(word[0]) + word[1:] if word in reserved else word


def _escape_character(character: str) -> str:
    return f"_u{ord(character):x}_"


def unescape_name(word: str) -> str:
    """Return the name that `escape_name` has written as `word`."""
    return _ESCAPE_SEQUENCE.sub(lambda match: chr(int(match[1], 16)), word)
