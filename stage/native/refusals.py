"""What a compiler says of a hot function that it cannot compile, in two lines: the source's line, and why."""

from __future__ import annotations

import inspect
import linecache
import re
from pathlib import Path
from typing import Any

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_AT = re.compile(r"^During: .* at (.+) \((\d+)\)$", re.MULTILINE)
_NOISE = re.compile(r"Failed in \w+ mode pipeline|^$")
_END = re.compile(r"There are \d|During: |File \"|Overload ")


def told(function: Any, error: BaseException) -> str:
    """The words. function: the Python function that was to be compiled; error: what numba raised."""
    text = _COLOURS.sub("", str(error))
    reason: list[str] = []
    for words in map(str.strip, text.splitlines()):
        if _END.match(words):
            break
        if not _NOISE.match(words):
            reason.append(words.removeprefix(">>> "))
    file, number = _place(function, error, text)
    source = linecache.getline(file, number).strip()
    shown = f"\n    {source}" if source else ""
    said = " ".join(reason) or type(error).__name__
    if "setitem(readonly array" in said:
        said += ". An array of a module is a constant here: what changes is a field of the record"
    return f'File "{file}", line {number}, in hot function {function.__name__}:{shown}\n{type(error).__name__}: {said}'


def _place(function: Any, error: BaseException, text: str) -> tuple[str, int]:
    """File and line of the innermost thing of ours that did not compile; else where the function begins."""
    code = inspect.unwrap(function).__code__
    places = [(file, int(line)) for file, line in _AT.findall(text)]
    if (loc := getattr(error, "loc", None)) is not None:
        places.append((str(loc.filename), int(loc.line)))
    for file, line in places:
        if Path(file).is_file() and "/numba/" not in file:
            return file, line
    return code.co_filename, code.co_firstlineno
