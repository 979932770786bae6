"""Commands of installed packages: `stage NAME` of a package works like a command of PulseStage itself.

A package lists its commands in its pyproject.toml, each with the function that adds it:

    [project.entry-points."pulsestage.commands"]
    bench = "registerbench.commands:add_bench"

The function gets argparse's subparsers and adds the command by `stage.cli.command_interface.add_command`. A package is imported
only when one of its commands, or the list of all commands, is requested. PulseStage's own commands take precedence.
"""

from __future__ import annotations

import sys
from typing import Any

from stage.errors import ArgumentError, StageError
from stage.support.entry_points import find_entry_points, load_entry_point

ENTRY_POINT_GROUP = "pulsestage.commands"
"""The entry points of a package that name commands."""

PACKAGE_BY_COMMAND = {
    name: "registerbench" for name in ("agent", "agent-replay", "bench", "bench-submit", "bench-table", "bench-verify")
}
"""Command -> folder below packages/ of the package that brings it. Distributions are called pulsestage-FOLDER."""


def add_package_commands(commands: Any) -> None:
    """Add the commands of installed packages to argparse's subparsers. Warn of a command that fails, and omit it."""
    for name, parts in sorted(find_entry_points(ENTRY_POINT_GROUP, str).items()):
        try:
            if name in commands.choices:
                raise ArgumentError(
                    f"command {name} of {parts[0]}: PulseStage has a command `stage {name}` of its own, which takes precedence."
                )
            load_entry_point("command", name, parts, use=lambda add: add(commands))
        except StageError as error:
            print(f"stage: warning: {error}", file=sys.stderr)


def explain_missing_command(name: str) -> str:
    """Return a sentence that names the package of a command that is not installed; "" for an unknown command."""
    if name not in PACKAGE_BY_COMMAND:
        return ""
    package = PACKAGE_BY_COMMAND[name]
    return (
        f"`stage {name}` comes with the package pulsestage-{package}, which is not installed: run "
        f"`pip install ./packages/{package}` in a checkout of PulseStage."
    )
