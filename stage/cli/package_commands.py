"""Commands that installed packages bring: `stage NAME` of a package works as a command of PulseStage's own.

A package names its commands in its pyproject.toml, each with the function that adds it:

    [project.entry-points."pulsestage.commands"]
    bench = "registerbench.commands:add_bench"

The function is called with argparse's subparsers and adds the command by `stage.cli.commands.add_command`. A package is imported
when one of its commands, or the list of all commands, is asked for. PulseStage's own commands take precedence.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "pulsestage.commands"
"""The entry points of a package that name commands."""

KNOWN_PACKAGES = {
    name: "registerbench" for name in ("agent", "agent-replay", "bench", "bench-submit", "bench-table", "bench-verify")
}
"""Command -> folder below packages/ of the package that brings it. Distributions are called pulsestage-FOLDER."""


def find_commands() -> Mapping[str, EntryPoint]:
    """Return the commands of installed packages by name; of two packages with one name that which Python finds first."""
    from importlib.metadata import entry_points  # 50 ms of a start that mostly needs PulseStage's own commands only

    return {point.name: point for point in reversed(list(entry_points(group=GROUP)))}


def add_package_commands(commands: Any) -> None:
    """Add the commands of installed packages to argparse's subparsers; warn of one that fails, and leave it out."""
    for name, point in sorted(find_commands().items()):
        if name in commands.choices:
            _warn(point, f"PulseStage has a command `stage {name}` of its own, which takes precedence")
            continue
        try:
            point.load()(commands)
        except (Exception, SystemExit) as error:  # it is somebody else's code
            _warn(point, f"`stage {name}` cannot be loaded: {type(error).__name__}: {error}")


def explain_missing_command(name: str) -> str:
    """Return the sentence that says which package brings a command that is not installed; "" for an unknown name."""
    if name not in KNOWN_PACKAGES:
        return ""
    package = KNOWN_PACKAGES[name]
    return (
        f"`stage {name}` comes with the package pulsestage-{package}, which is not installed: run "
        f"`pip install ./packages/{package}` in a checkout of PulseStage."
    )


def _warn(point: EntryPoint, text: str) -> None:
    package = f"{point.dist.name} {point.dist.version}" if point.dist is not None else point.value
    print(f"stage: warning: package {package}: {text}.", file=sys.stderr)
