"""`--json`: what a command has to say as one JSON object on standard output, in place of its text.

A command says its facts by `tell`, whether somebody asks for JSON or not, and prints its text as ever. With --json the text goes
nowhere, and the facts are printed at the end, also where the exit code is 1. Errors are on standard error as ever.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import fields, is_dataclass
from typing import Any


def tell(args: argparse.Namespace, facts: Any = None, /, **more: Any) -> None:
    """Say facts: a whole of its own, or further entries of an object."""
    if facts is not None:
        args.facts = facts
    if more:
        args.facts = getattr(args, "facts", {}) | more


def wrote(args: argparse.Namespace, path: Any, text: str) -> None:
    """Say, and print, that a file has been written."""
    print(f"{path}: {text}")
    if (files := getattr(args, "files", None)) is not None:
        files.append(os.fspath(path))


def as_json(run: Callable[[argparse.Namespace], int], args: argparse.Namespace) -> int:
    """Run a command; print its facts, and the files that it wrote."""
    args.files = []
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        code = run(args)
    facts = getattr(args, "facts", {})
    if args.files and isinstance(facts, dict):
        facts = facts | {"files": args.files}
    print(json.dumps(plain(facts), indent=1, allow_nan=False))
    return code


def plain(value: Any) -> Any:
    """A value as JSON has it: an object's own `json()`, else its fields; null for what is no finite number."""
    if hasattr(value, "json"):
        return plain(value.json())
    if hasattr(value, "tolist"):  # NumPy's
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(v) for key, v in value.items()}
    if is_dataclass(value):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return str(value)
