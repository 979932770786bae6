"""Explanation of errors of numba in two lines: the line of the source that does not compile, and the reason."""

from __future__ import annotations

import inspect
import linecache
import re
from pathlib import Path
from typing import Any

_ANSI_COLORS = re.compile(r"\x1b\[[0-9;]*m")
_PLACE = re.compile(r"^During: .* at (.+) \((\d+)\)$", re.MULTILINE)
_SKIPPED_LINE = re.compile(r"Failed in \w+ mode pipeline|^$")
_LAST_LINE = re.compile(r"There are \d|During: |File \"|Overload ")


def explain_compile_error(function: Any, error: BaseException) -> str:
    """Explain an error of numba.

    Args:
        function: Python function that was compiled.
        error: Exception that numba has raised.
    """
    text = _ANSI_COLORS.sub("", str(error))
    reason: list[str] = []
    for words in map(str.strip, text.splitlines()):
        if _LAST_LINE.match(words):
            break
        if not _SKIPPED_LINE.match(words):
            reason.append(words.removeprefix(">>> "))
    file, number = _find_place(function, error, text)
    source = linecache.getline(file, number).strip()
    quoted = f"\n    {source}" if source else ""
    text = " ".join(reason) or type(error).__name__
    if "setitem(readonly array" in text:
        text += ". An array of a module is a constant here: what changes is a field of the record"
    return f'File "{file}", line {number}, in hot function {function.__name__}:{quoted}\n{type(error).__name__}: {text}'


def _find_place(function: Any, error: BaseException, text: str) -> tuple[str, int]:
    """Return file and line of the innermost statement outside numba that did not compile; else the start of the function."""
    code = inspect.unwrap(function).__code__
    places = [(file, int(line)) for file, line in _PLACE.findall(text)]
    if (loc := getattr(error, "loc", None)) is not None:
        places.append((str(loc.filename), int(loc.line)))
    for file, line in places:
        if Path(file).is_file() and "/numba/" not in file:
            return file, line
    return code.co_filename, code.co_firstlineno
