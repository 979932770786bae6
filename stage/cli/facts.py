"""`--json`: what a command has to say as one JSON object on standard output, in place of its text.

A command says its facts by `tell`, whether somebody asks for JSON or not, and prints its text as ever. With --json the text goes
nowhere, and the facts are printed at the end, also where the exit code is 1. Errors are on standard error as ever, as JSON, too.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
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
    args.wrote.append(os.fspath(path))


def warn(args: argparse.Namespace, text: str) -> None:
    """Say on standard error, or in JSON as one of "warnings", what goes on all the same."""
    if getattr(args, "json", False):
        args.warnings = [*getattr(args, "warnings", ()), text]
    else:
        print(f"stage: warning: {text}", file=sys.stderr)


def fail(args: argparse.Namespace, error: BaseException, text: str = "") -> None:
    """Say on standard error what went wrong, in JSON where that is asked for; text: other words than the error's own."""
    said = text or str(error)
    if getattr(args, "json", False):
        print(json.dumps({"error": said, "type": type(error).__name__}), file=sys.stderr)
    else:
        print(f"stage: {said}", file=sys.stderr)


def interrupted(args: argparse.Namespace) -> str:
    """What to say where Ctrl-C has ended a command: also which of the files that were asked for are not there."""
    made = getattr(args, "wrote", [])
    asked = {
        name: getattr(args, name, None) for name in ("output", "record", "vcd", "picture", "plot", "trace", "entry")
    }
    missing = [f"--{name} {path}" for name, path in asked.items() if path not in (None, "-") and path not in made]
    return "interrupted" + (f": nothing to write yet for {', '.join(missing)}" if missing else "") + "."


def as_json(run: Callable[[argparse.Namespace], int], args: argparse.Namespace) -> int:
    """Run a command; print its facts, the files that it wrote and what it warned of, also where Ctrl-C ends it."""
    with open(os.devnull, "w", encoding="utf-8", errors="replace") as nowhere, redirect_stdout(nowhere):
        try:
            code = run(args)
        except KeyboardInterrupt as stop:
            interrupted: KeyboardInterrupt | None = stop
        else:
            interrupted = None
    facts = plain(getattr(args, "facts", {}))
    if isinstance(facts, dict):
        told = {"files": args.wrote, "warnings": getattr(args, "warnings", None)}
        facts |= {name: given for name, given in told.items() if given}
        facts |= {"interrupted": True} if interrupted is not None else {}
    if interrupted is None or facts:
        print(json.dumps(facts, indent=1, allow_nan=False))
    if interrupted is not None:
        raise interrupted
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
