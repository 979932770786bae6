"""The command `stage example`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from stage.cli.command_interface import add_command, add_facts, report_written_file
from stage.cli.options import add_force_option
from stage.support.extras import is_installed


def add_subcommand(commands: Any) -> None:
    """Add `stage example` to argparse's subparsers."""
    p = add_command(
        commands, "example", run, "copy an example: programs, drivers, chips, notebooks",
        "Copy one of the examples of the documentation into a folder. Without a name, list them.",
        ("stage example", "list the examples"),
        ("stage example home_and_move", "copy home_and_move.py to the current folder"),
        ("stage example drivers --to ~/firmware", "copy the drivers in C, C++, Rust and Zig"),
    )  # fmt: skip
    p.add_argument("name", nargs="?", metavar="NAME", help="example to copy, such as stall (default: list them)")
    p.add_argument("--to", default=".", metavar="FOLDER", help="folder for the copy (default: the current folder)")
    add_force_option(p)


def run(args: argparse.Namespace) -> int:
    """Copy an example, or list all examples."""
    from stage.support import examples

    if args.name is None:
        titles = {name: _describe_example(name) for name in examples.EXAMPLE_PATHS}
        add_facts(args, titles)
        width = max(map(len, titles))
        print("\n".join(f"{name:{width}}  {title}" for name, title in titles.items()))
        return 0
    name = args.name.removesuffix(".py")
    copy = examples.copy_example(name, Path(args.to), args.force)
    extra = examples.REQUIREMENTS.get(name)
    is_missing = extra is not None and not is_installed(extra.library)
    report_written_file(args, copy, _explain_next_step(copy) + (f"; it {extra}" if is_missing else ""))
    return 0


def _describe_example(name: str) -> str:
    """Return the description of an example, and the extra that it needs."""
    from stage.support import examples

    extra = examples.REQUIREMENTS.get(name)
    return examples.read_title(name) + (f" It {extra}." if extra else "")


def _explain_next_step(copy: Path) -> str:
    """Return a sentence that says how to run the copied example."""
    if copy.suffix == ".py":
        return f"run it with: python {copy}"
    if copy.suffix == ".ipynb":
        jupyter = "" if is_installed("jupyterlab") else " (pip install jupyterlab)"
        return f"a notebook; open it with: jupyter lab {copy}{jupyter}, or in an editor that runs notebooks"
    page = next((p for p in ("README.md", "pyproject.toml") if (copy / p).exists()), None)
    return f"a folder; begin with {copy / page}" if page else "a folder"
