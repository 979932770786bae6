"""Arduino sketches as C++: what the Arduino tools add, an include of Arduino.h and a prototype of each function."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

SKETCHES = (".ino", ".pde")
"""Endings of sketches; the second is that of the first versions of Arduino."""
_SOURCES = (*SKETCHES, ".c", ".cc", ".cpp", ".cxx")
_NON_CODE_PATTERN = re.compile(
    r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|^[^\S\n]*#(?:\\\n|[^\n])*", re.S | re.M
)
"""Comments, strings and lines of the preprocessor."""
_FUNCTION = re.compile(r"([\w:<>,*&\s]+?[\s*&])(\w+)\s*\(([^(){};]*(?:\([^(){};]*\)[^(){};]*)*)\)\s*$")
_NO_TYPE = ("else", "return", "do", "new", "throw", "goto", "case")


def list_sketch_files(source: Path) -> list[Path]:
    """Return a source; with it, for a sketch in a folder of its own name, the other sources of that folder, behind the sketch."""
    if source.suffix not in SKETCHES or source.resolve().parent.name != source.stem:
        return [source]
    others = sorted(f for f in source.parent.iterdir() if f.suffix in _SOURCES and f.name != source.name)
    return [source, *sorted(others, key=lambda file: file.suffix not in SKETCHES)]


def translate_sketch(sketches: Mapping[Path, str]) -> str:
    """Make one C++ source of a sketch's files, in their order. Errors of the compiler name lines of the sketch."""
    text = "".join(f'#line 1 "{_quote(path)}"\n{text}\n' for path, text in sketches.items())
    functions = _find_functions(_blank_out(text))
    if not functions:
        return f"#include <Arduino.h>\n{text}"
    at = functions[0][0]
    line = _make_line_mark(text, at)
    prototypes = "".join(f"{_make_line_mark(text, place)}{prototype};\n" for place, prototype in functions)
    return f"#include <Arduino.h>\n{text[:at]}\n{prototypes}{line}{text[at:]}"


def _quote(path: Path) -> str:
    return str(path).replace("\\", "\\\\").replace('"', '\\"')


def _make_line_mark(text: str, at: int) -> str:
    """Return a #line directive for the place `at` of a sketch."""
    before = text[:at]
    mark = list(re.finditer(r'^#line 1 ("[^\n]*")\n', before, re.M))[-1]
    return f"#line {before[mark.end() :].count(chr(10)) + 1} {mark[1]}\n"


def _blank_out(text: str) -> str:
    """Replace comments, strings and lines of the preprocessor by spaces."""
    return _NON_CODE_PATTERN.sub(lambda m: re.sub(r"[^\n]", " ", m[0]), text)


def _find_functions(text: str) -> list[tuple[int, str]]:
    """Return (where it begins, prototype) of each function that is defined outside of braces and may have a prototype."""
    found, depth, begin = [], 0, 0
    for m in re.finditer(r"[{};]", text):
        if m[0] == "{":
            if depth == 0 and (function := _FUNCTION.search(text[begin : m.start()])):
                kind, name, arguments = function.groups()
                words = kind.split()
                at = begin + function.start() + len(kind) - len(kind.lstrip())
                may_have = not {"template", ":"}.intersection(words) and "::" not in kind and "=" not in arguments
                if may_have and words and words[0] not in _NO_TYPE and name not in ("if", "for", "while", "switch"):
                    found.append((at, f"{' '.join(words)} {name}({' '.join(arguments.split())})"))
            depth += 1
        elif m[0] == "}":
            depth = max(0, depth - 1)
        if depth == 0:
            begin = m.end()
    return found
