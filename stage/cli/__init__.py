"""The command `stage`.

Exit codes: 0 done as asked; 1 it ran, but not as asked (lost steps, stopped by a limit); 2 wrong usage or an error that
says what to do; 130 interrupted.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stage.cli.parser import Parser

EPILOG = """\
examples:
  stage demo                              home three axes, dual-rate move, a:b move; writes demo.rrd
  stage home x --plot home.png            origin return, drawn like the data sheet's operation patterns
  stage move x 8000 --fh1 20000           a preset move of 8000 pulses
  stage move x 10mm --chips hctl1100      any chip: 10 mm by a servo
  stage move x 8000 --chips pcl240ms --s-curve --plot s.png
  stage sync x=20000 y=-7500              two axes along a straight line, in the ratio a:b
  stage tune xy --payload 2 --distance 100mm     registers for an axis: formula, search, proof
  stage run driver.c --chips pcl240mk     firmware in C drives the chips
  stage panel xy                          a live stage in a browser
  stage mcp xy                            tools for agents, by the Model Context Protocol
  stage serve --chips mcx304              the chips behind a TCP port, for a host elsewhere
  stage fault                             what can break; `stage fault jam --plot jam.png` breaks it
  stage export demo.rrd -o demo.csv       the columns of a recording as a table
  stage example                           what examples there are; `stage example stall` copies one
  stage erratum                           the S-curve failure of the MCX304: pulses for ever, and a work-around
  stage chips                             the chips that there are, also those of other packages
  stage registers pcl240k                 the register map
  stage pullout --motor 17HS4401          the pull-out curve

exit codes: 0 done as asked, 1 ran but not as asked (lost steps, limit switch), 2 wrong usage, 130 interrupted
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    from stage.cli.output import printing

    return printing(lambda: _main(argv))


def _main(argv: Sequence[str] | None) -> int:
    from stage.cli.facts import fail, interrupted
    from stage.errors import StageError

    typed = list(sys.argv[1:] if argv is None else argv)
    parser = build_parser(typed)
    if "_ARGCOMPLETE" in os.environ:  # a shell asks what may come next: `stage completion`
        import argcomplete

        argcomplete.autocomplete(parser)
    args = parser.parse([*typed[1:], "--help"] if typed[:1] == ["help"] else typed)
    if args.run is None:
        parser.print_help()
        return 2
    try:
        return args.run(args)
    except (StageError, FileNotFoundError, PermissionError) as error:
        fail(args, error)
        return 2
    except (OSError, MemoryError) as error:
        what = getattr(error, "strerror", None) or str(error) or "no memory"
        fail(
            args,
            error,
            f"the system refuses it: {what}. `ulimit -a` shows what this process may have, `df` how full disks are.",
        )
        return 2
    except KeyboardInterrupt as stop:
        if argv is None:  # the process ends: a second Ctrl-C ends it at once, without a word
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        fail(args, stop, interrupted(args))
        return 130


def build_parser(words: Sequence[str] = ()) -> Parser:
    """Build the command line; cheap, as nothing heavy is imported before a command runs.

    Args:
        words: What was typed. Packages are only looked at where the first word is no command of PulseStage's own.
    """
    from stage import __version__
    from stage.cli.arguments import agents, data, faults, firmware, moves, tools, tuning
    from stage.cli.parser import Parser

    parser = Parser(
        prog="stage",
        description="Emulated motion-control chips drive an XYZ stage in MuJoCo, register for register.",
        epilog=EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"pulsestage {__version__}")
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for group in (moves, tuning, agents, firmware, faults, data, tools):
        group.add(commands)
    if not (words and words[0] in commands.choices):
        from stage.cli.package_commands import add_package_commands

        add_package_commands(commands)
    return parser
