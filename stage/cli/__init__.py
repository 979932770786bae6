"""The command `stage`.

Exit codes: 0: done as requested; 1: done, but not as requested (lost steps, stopped by a limit); 2: wrong usage, or an error whose
message says what to do; 130: interrupted.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stage.cli.argument_parser import Parser

MODULES = (
    "demo", "home", "move", "tune", "mcp", "run", "replay", "serve", "panel", "fault", "erratum", "export", "example", "listing",
    "pullout", "view", "new_model", "completion",
)  # fmt: skip
"""Modules of this package that add commands, in the order of the help text."""

EPILOG = """\
examples:
  stage demo                              home three axes, dual-rate move, a:b move; writes demo.rrd
  stage home x --plot home.png            origin return, drawn like the data sheet's operation patterns
  stage move x 8000 --fh1 20000           a preset move of 8000 pulses
  stage move x 10mm --chips hctl1100      with any chip: 10 mm by a servo
  stage move x 8000 --chips pcl240ms --s-curve --plot s.png
  stage sync x=20000 y=-7500              two axes along a straight line, in the ratio a:b
  stage tune xy --payload 2 --distance 100mm     registers for an axis: formula, search, proof
  stage run driver.c --chips pcl240mk     firmware in C drives the chips
  stage replay capture.vcd --pins x.step=D2,x.dir=D5    the steps of a real controller, from a logic analyser
  stage panel xy                          a live stage in a browser
  stage mcp xy                            tools for agents, by the Model Context Protocol
  stage serve --chips mcx304              the chips behind a TCP port, for a host elsewhere
  stage fault                             the faults; `stage fault jam --plot jam.png` shows one
  stage export demo.rrd -o demo.csv       the columns of a recording as a table
  stage example                           the examples; `stage example stall` copies one
  stage erratum                           the S-curve failure of the MCX304: endless pulses, and a work-around
  stage chips                             the chips, also those of other packages
  stage registers pcl240k                 the register map of a chip
  stage pullout --motor 17HS4401          the pull-out curve of a motor

exit codes: 0 success, 1 the run failed (lost steps, limit switch), 2 wrong usage, 130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line, and return the exit code."""
    from stage.cli.terminal import run_with_output

    return run_with_output(lambda: _run(argv))


def _run(argv: Sequence[str] | None) -> int:
    """Parse the words and run their command; return the exit code, also for an error or Ctrl-C."""
    from stage.cli.commands import describe_interruption, fail
    from stage.cli.completion import complete
    from stage.errors import StageError

    words = list(sys.argv[1:] if argv is None else argv)
    parser = build_parser(words)
    complete(parser)
    args = parser.parse([*words[1:], "--help"] if words[:1] == ["help"] else words)
    if args.run is None:
        parser.print_help()
        return 2
    try:
        return args.run(args)
    except (StageError, FileNotFoundError, PermissionError) as error:
        fail(args, error)
        return 2
    except (OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error) or "no memory"
        hint = "`ulimit -a` shows the limits of this process, `df` how full the disks are."
        fail(args, error, f"the system refuses it: {reason}. {hint}")
        return 2
    except KeyboardInterrupt as stop:
        if argv is None:  # the process ends: a second Ctrl-C ends it at once, without a word
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        fail(args, stop, describe_interruption(args))
        return 130


def build_parser(words: Sequence[str] = ()) -> Parser:
    """Build the parser of the command line. This is fast, because a command imports its libraries only when it runs.

    Args:
        words: The typed words. Commands of other packages are looked for only if the first word is no command of PulseStage.
    """
    from stage import __version__
    from stage.cli.argument_parser import Parser
    from stage.cli.package_commands import add_package_commands

    parser = Parser(
        prog="stage",
        description="Emulated motion-control chips drive an XYZ stage in MuJoCo, register for register.",
        epilog=EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"pulsestage {__version__}")
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name in MODULES:
        import_module(f"stage.cli.{name}").add_subcommand(commands)
    if not (words and words[0] in commands.choices):
        add_package_commands(commands)
    return parser
