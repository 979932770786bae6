"""Interface of the commands of `stage`, for the commands of this package and of others.

    def add_greet(commands):
        p = add_command(commands, "greet", greet, "greet somebody", "Greet somebody.", ("stage greet 3", "three times"))
        p.add_argument("times", type=parse_integer)

    def greet(args):
        print("hello " * args.times)
        add_facts(args, times=args.times)
        return 0

A command prints text, and adds facts by `add_facts`. With --json, the text is dropped and the facts are printed as one JSON object
at the end, also if the exit code is 1. Errors go to standard error, as JSON with --json.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from stage.cli.argument_parser import EXAMPLES
from stage.cli.options import TIME, parse_integer

__all__ = ["TIME", "add_command", "parse_integer", "add_facts", "warn", "report_written_file"]

OUTPUT_OPTIONS = ("output", "record", "vcd", "picture", "plot", "trace", "entry")
"""Options that name a file to write."""


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    help_: str,
    description: str,
    *examples: tuple[str, str],
    more: str = "",
    json: bool = True,
) -> argparse.ArgumentParser:
    """Add a subcommand to the command line, and return its parser.

    Args:
        commands: Subparsers of the command line.
        name: Word that users type after `stage`.
        run: Function of the parsed arguments that returns the exit code.
        help_: Line for the list of commands.
        description: Paragraph at the beginning of the command's help.
        examples: Pairs of a command line and a description of its effect.
        more: Paragraph after the examples.
        json: Whether the command has the option --json.
    """
    p = commands.add_parser(name, help=help_, description=description, epilog=format_examples(examples, more))
    p.summary = help_
    if json:
        p.add_argument("--json", action="store_true", help="print JSON instead of text")

    def call(args: argparse.Namespace) -> int:
        """Run the subcommand, with its facts as JSON if --json is given."""
        args.written_files = []
        return run_as_json(run, args) if json and args.json else run(args)

    p.set_defaults(run=call, parser=p)
    return p


def format_examples(examples: Iterable[tuple[str, str]], more: str = "") -> str:
    """Return the end of a help text: a line for each pair of a command line and its effect, then the paragraph `more`."""
    examples = list(examples)
    width = min(max(len(line) for line, _ in examples), 64)
    lines = "\n".join(f"  {line:{width}}  {effect}".rstrip() for line, effect in examples)
    return EXAMPLES + lines + (f"\n\n{more}" if more else "")


def add_facts(args: argparse.Namespace, facts: Any = None, /, **more: Any) -> None:
    """Set the facts of a command, which --json prints, or add entries to them.

    Args:
        args: Options of the command, which store the facts.
        facts: All facts, any value that `to_json` converts; None: keep the present ones.
        **more: Facts to add by name.
    """
    if facts is not None:
        args.facts = facts
    if more:
        args.facts = getattr(args, "facts", {}) | more


def report_written_file(args: argparse.Namespace, path: Any, text: str) -> None:
    """Print that a command has written a file, and add the file to the facts that --json prints.

    Args:
        args: Options of the command.
        path: The file.
        text: Text after the path, for example the size of the file.
    """
    print(f"{path}: {text}")
    args.written_files.append(os.fspath(path))


def warn(args: argparse.Namespace, text: str) -> None:
    """Print a warning to standard error; with --json, add it to the printed JSON object."""
    if getattr(args, "json", False):
        args.warnings = [*getattr(args, "warnings", ()), text]
    else:
        print(f"stage: warning: {text}", file=sys.stderr)


def print_error(args: argparse.Namespace, error: BaseException, text: str = "") -> None:
    """Print an error to standard error, as JSON with --json. `text` replaces the message of the error."""
    text = text or str(error)
    if getattr(args, "json", False):
        print(json.dumps({"error": text, "type": type(error).__name__}), file=sys.stderr)
    else:
        print(f"stage: {text}", file=sys.stderr)


def describe_interruption(args: argparse.Namespace) -> str:
    """Return the message for a command that Ctrl-C has ended; it names the files that were requested but not written."""
    written = getattr(args, "written_files", [])
    requested = {name: getattr(args, name, None) for name in OUTPUT_OPTIONS}
    missing = [
        f"--{name} {path}" for name, path in requested.items() if path not in (None, "-") and path not in written
    ]
    return "interrupted" + (f": nothing to write yet for {', '.join(missing)}" if missing else "") + "."


def run_as_json(run: Callable[[argparse.Namespace], int], args: argparse.Namespace) -> int:
    """Run a command, and print its facts, files and warnings as JSON instead of its text, even if Ctrl-C ends the command."""
    interruption: KeyboardInterrupt | None = None
    with Path(os.devnull).open("w", encoding="utf-8", errors="replace") as nowhere, redirect_stdout(nowhere):
        try:
            code = run(args)
        except KeyboardInterrupt as stop:
            interruption = stop
    facts = to_json(getattr(args, "facts", {}))
    if isinstance(facts, dict):
        more = {
            "files": args.written_files,
            "warnings": getattr(args, "warnings", None),
            "interrupted": interruption is not None,
        }
        facts |= {name: value for name, value in more.items() if value}
    if interruption is None or facts:
        print(json.dumps(facts, indent=1, allow_nan=False))
    if interruption is not None:
        raise interruption
    return code


def to_json(value: Any) -> Any:
    """Convert a value for JSON: by its method `json()`, or from its fields; null for NaN and infinity."""
    if hasattr(value, "json"):
        return to_json(value.json())
    if hasattr(value, "tolist"):  # NumPy's
        return to_json(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(key): to_json(v) for key, v in value.items()}
    if is_dataclass(value):
        return {f.name: to_json(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return to_json(value._asdict())
    if isinstance(value, list | tuple):
        return [to_json(v) for v in value]
    return str(value)
