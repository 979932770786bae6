"""Reference pages of the site, generated from packages, command line and register maps."""

from __future__ import annotations

import argparse
import importlib
import inspect
from pathlib import Path
from typing import Any

from stage.chips import CHIPS
from stage.chips.register_map import Register, RegisterMap
from stage.cli import build_parser

PACKAGES = [
    "stage", "stage.chips", "stage.firmware", "stage.drives.motors", "stage.recording", "stage.board", "stage.testing",
    "stage.targets", "stage.serve.client", "stage.sim.faults", "stage.envs", "stage.tune", "stage.study",
    "stage.panel.session",
]  # fmt: skip


def write(pages: Path) -> dict[str, list[tuple[str, str]]]:
    """Write all reference pages.

    Args:
        pages: Folder of the site's pages.

    Returns:
        The pages of each group of the navigation, as (title, path).
    """
    folder = pages / "reference"
    folder.mkdir(exist_ok=True)
    (folder / "command_line.md").write_text(format_command_line_page())
    pages_by_section: dict[str, list[tuple[str, str]]] = {"Register maps": [], "Python": []}
    for line in CHIPS.list_chips():
        if line.chip is not None and line.package == "pulsestage":
            name = line.name.lower()
            (folder / f"map_{name}.md").write_text(format_register_map_page(line.chip.MAP))
            pages_by_section["Register maps"].append((line.name, f"reference/map_{name}.md"))
    for package in PACKAGES:
        path = f"reference/{package.replace('.', '_')}.md"
        (pages / path).write_text(format_package_page(package))
        pages_by_section["Python"].append((package, path))
    return pages_by_section


def format_package_page(package: str) -> str:
    """Format a page for mkdocstrings: the docstring of a package, and each public name where it is defined."""
    module = importlib.import_module(package)
    text = [f"# {package}\n", f"::: {package}\n    options:\n      members: []\n      show_root_heading: false\n"]
    for name in list_public_names(module):
        thing = getattr(module, name)
        where = getattr(thing, "__module__", None)
        if inspect.ismodule(thing):
            text.append(f"`{name}`: a module, [{thing.__name__}]({thing.__name__.replace('.', '_')}.md).\n")
        elif isinstance(where, str) and hasattr(thing, "__qualname__"):
            text.append(f"::: {where}.{thing.__qualname__}\n")
    return "\n".join(text)


def list_public_names(module: Any) -> list[str]:
    """Return the public names of a module, in the order of `__all__` or of its definitions."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    return [
        name for name, thing in vars(module).items()
        if not name.startswith("_") and getattr(thing, "__module__", None) == module.__name__
    ]  # fmt: skip


def format_command_line_page() -> str:
    """Format a page with the help of every command, as the terminal shows it."""
    parser = build_parser()
    commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    text = ["# Command line\n", "```text\n" + parser.format_help().rstrip() + "\n```\n"]
    for name, command in commands.choices.items():
        text.append(f"## stage {name}\n\n```text\n{command.format_help().rstrip()}\n```\n")
    return "\n".join(text)


def format_register_map_page(map_: RegisterMap) -> str:
    """Format a page with the registers, words and commands of a chip as tables."""
    text = [
        f"# {map_.chip}\n",
        f"{map_.title}. Source: {map_.source}. `stage registers {map_.chip.lower()}` prints the same.\n",
    ]
    text += ["## Registers\n", "| register | bits | access | legal | evidence | |", "|---|---|---|---|---|---|"]
    text += [
        f"| `{r.name}` | {r.bits} | {r.access} | {_format_legal_values(r)} | {r.evidence} | {_escape_cell(r.description)} |"
        for r in map_.registers
    ]
    for place in map_.places:
        if place.fields:
            text += [f"\n### {place.name}\n", _escape_cell(place.description) + "\n"]
            text += ["| bits | field | evidence | |", "|---|---|---|---|"]
            text += [f"| {f.bits} | `{f.name}` | {f.evidence} | {_escape_cell(f.description)} |" for f in place.fields]
    text += ["\n## Commands\n", "| code | command | evidence | |", "|---|---|---|---|"]
    text += [f"| {c.hex} | `{c.symbol}` | {c.evidence} | {_escape_cell(c.description)} |" for c in map_.commands]
    return "\n".join(text) + "\n"


def _format_legal_values(r: Register) -> str:
    from stage.chips.register_map import _format_range as format_range

    return _escape_cell(format_range(r))


def _escape_cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")
