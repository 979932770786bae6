"""The command `stage`.

Exit codes: 0: done as requested; 1: done, but not as requested (lost steps, stopped by a limit); 2: wrong usage, or an error whose
message says what to do; 130: interrupted.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stage.cli.argument_parser import Parser

COMMANDS = {
    "demo": "demo", "home": "home", "move": "move", "dual-rate": "move", "sync": "move", "tune": "tune", "mcp": "mcp",
    "run": "run", "include": "run", "replay": "replay", "serve": "serve", "ioc": "ioc", "panel": "panel", "fault": "fault",
    "erratum": "erratum", "export": "export", "example": "example", "list": "listing", "chips": "listing",
    "registers": "listing", "pullout": "pullout", "view": "view", "new-model": "new_model", "completion": "completion",
}  # fmt: skip
"""Commands of PulseStage, and the module of this package that adds each."""

GROUPS = {
    "see": ("demo", "panel", "view", "fault", "erratum", "pullout"),
    "move": ("move", "home", "dual-rate", "sync", "ioc"),
    "test firmware": ("run", "replay", "serve", "include"),
    "tune and learn": ("tune", "mcp", "agent", "agent-replay", "bench", "bench-submit", "bench-table", "bench-verify"),
    "more": ("example", "new-model", "list", "chips", "registers", "export", "completion"),
}
"""Commands by the group of the help text; a command of another package that is in none of them belongs to the last group."""

DESCRIPTION = "PulseStage: emulated motion-control chips drive motors, and the motors move a machine in MuJoCo."

OVERVIEW = f"""\
{DESCRIPTION}

  stage demo               home and move three axes, and draw what happened
  stage panel              a live machine in a browser
  stage move x 10mm        one move, with the bytes that made it
  stage run driver.c       your firmware, in C or as the binary of a microcontroller
  stage tune xy            registers for a move of an axis, with a proof
  stage example            programs, drivers and notebooks to copy

`stage --help` lists all commands, `stage COMMAND --help` explains one.
"""
"""Text of the bare command `stage`."""

EPILOG = """\
examples:
  stage home x --plot home.png            an origin return, drawn as data sheets do
  stage move x 10mm --speed 50mm/s        a move with any chip: --chips mcx514
  stage move x 8000 --fh1 20000           the same in pulses, and pulses per second
  stage run driver.c --chips pcl240mk     firmware in C drives the chips
  stage fault jam --plot jam.png          the effect of a bearing that jams
  stage registers pcl240k                 the register map of a chip

exit codes: 0 success, 1 the run failed (lost steps, limit switch), 2 wrong usage, 130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line, and return the exit code."""
    from stage.cli.output_and_progress import run_with_output

    return run_with_output(lambda: _run(argv))


def _run(argv: Sequence[str] | None) -> int:
    """Parse the words and run their command; return the exit code, also for an error or Ctrl-C."""
    from stage.cli.command_interface import describe_interruption, print_error
    from stage.cli.completion import complete
    from stage.errors import StageError

    words = list(sys.argv[1:] if argv is None else argv)
    parser = build_parser(words)
    complete(parser)
    args = parser.parse([*words[1:], "--help"] if words[:1] == ["help"] else words)
    if args.run is None:
        print(OVERVIEW, end="")
        return 2
    try:
        return args.run(args)
    except (StageError, FileNotFoundError, PermissionError) as error:
        print_error(args, error)
        return 2
    except (OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error) or "no memory"
        hint = "`ulimit -a` shows the limits of this process, `df` how full the disks are."
        print_error(args, error, f"the system refuses it: {reason}. {hint}")
        return 2
    except KeyboardInterrupt as stop:
        if argv is None:  # the process ends: a second Ctrl-C ends it at once, without a word
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        print_error(args, stop, describe_interruption(args))
        return 130


def build_parser(words: Sequence[str] = ()) -> Parser:
    """Build the parser of the command line. This is fast, because a command imports its libraries only when it runs.

    Args:
        words: The typed words. If the first one is a command of PulseStage, the parser has no other commands than those of its
            module, and other packages are not searched for commands.
    """
    from stage import __version__
    from stage.cli.argument_parser import Parser
    from stage.cli.package_commands import add_package_commands

    parser = Parser(
        prog="stage", usage="stage [-h] [--version] COMMAND ...", description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"pulsestage {__version__}")
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(prog="stage", metavar="COMMAND", help=argparse.SUPPRESS)
    module = COMMANDS.get(words[0]) if words else None
    for name in dict.fromkeys(COMMANDS.values()) if module is None else (module,):
        import_module(f"stage.cli.{name}").add_subcommand(commands)
    if module is None:
        add_package_commands(commands)
    parser.epilog = f"{format_groups(commands)}\n{EPILOG}"
    return parser


def format_groups(commands: Any) -> str:
    """Return the list of commands for the help text: a heading for each group, and a line for each command."""
    effects = {name: getattr(p, "summary", "") for name, p in commands.choices.items()}
    listed = {name for names in GROUPS.values() for name in names}
    *_, last = GROUPS
    lines = []
    for group, names in GROUPS.items():
        others = [name for name in effects if name not in listed] if group == last else []
        lines += [f"{group}:", *(f"  {name:14}{effects[name]}" for name in (*names, *others) if name in effects), ""]
    return "\n".join(lines)
