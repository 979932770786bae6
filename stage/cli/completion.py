"""The command `stage completion`, and the answers to a shell that completes a command line."""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING, Any

from stage.cli.command_interface import add_command

if TYPE_CHECKING:
    from stage.cli.argument_parser import Parser


def add_subcommand(commands: Any) -> None:
    """Add `stage completion` to argparse's subparsers."""
    p = add_command(
        commands, "completion", run, "print a script that completes commands and options in a shell",
        "Print the script that makes a shell complete this command line with the Tab key.",
        ('eval "$(stage completion bash)"', "in ~/.bashrc"),
        ('eval "$(stage completion zsh)"', "in ~/.zshrc"),
        ("stage completion fish | source", "in ~/.config/fish/config.fish"),
        json=False,
    )  # fmt: skip
    p.add_argument("shell", choices=("bash", "zsh", "fish"))


def run(args: argparse.Namespace) -> int:
    """Print the script that a shell reads to complete this command line."""
    from stage.support.extras import import_extra

    print(import_extra("argcomplete", "completion").shellcode(["stage"], shell=args.shell))
    return 0


def complete(parser: Parser) -> None:
    """Answer a shell that asks for completions, and end the process; return if no shell asks."""
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        parser.set_completers()
        argcomplete.autocomplete(parser, always_complete_options=False)
