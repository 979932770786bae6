"""What commands have in common: groups of options."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import Any

from stage.cli.parser import examples
from stage.cli.quantities import RATE, TIME, VOLTAGE

PCL240 = ("PCL240K", "PCL240MK", "PCL240MS")


ALL = (*PCL240, "MCX514", "MCX512", "MCX501", "MCX314AS", "MCX304", "MCX302", "MCX312", "HCTL1100")


class Given(argparse.Action):
    """Stores a value, and as NAME_given that somebody gave it."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        setattr(namespace, self.dest, values)
        setattr(namespace, f"{self.dest}_given", True)


def command(
    commands: Any,
    name: str,
    run: str | Callable[[argparse.Namespace], int],
    help_: str,
    description: str,
    *shown: tuple[str, str],
    more: str = "",
    json: bool = True,
) -> argparse.ArgumentParser:
    """Add a subcommand and return its parser.

    Args:
        commands: Subparsers of the command line.
        name: What is typed after `stage`.
        run: Function of the parsed arguments that returns the exit code; or "module:function" of stage.cli, imported when it runs.
        help_: Line for the list of commands.
        description: Paragraph at the beginning of the command's help.
        shown: Examples as (what is typed, what it does).
        more: Paragraph behind the examples.
        json: Offer --json; the command then says its facts by `tell`.
    """
    p = commands.add_parser(name, help=help_, description=description, epilog=examples(shown, more))
    if json:
        p.add_argument("--json", action="store_true", help="print JSON in place of text")

    def call(args: argparse.Namespace) -> int:
        from importlib import import_module

        module, _, function = run.partition(":") if isinstance(run, str) else ("", "", "")
        work = run if callable(run) else getattr(import_module(f"stage.cli.{module}"), function)
        args.wrote = []
        if not (json and args.json):
            return work(args)
        from stage.cli.facts import as_json

        return as_json(work, args)

    p.set_defaults(run=call, parser=p)
    return p


def stage_and_outputs(p: argparse.ArgumentParser, chips: Sequence[str] = ALL) -> None:
    g = p.add_argument_group("stage")
    g.add_argument("--model", default="xyz", help=model_help())
    machine(g, chips)
    outputs(p)


def model_help() -> str:
    """What a model may be, and which ship."""
    from importlib import import_module

    return f"a shipped model ({', '.join(import_module('stage.models').names())}) or an MJCF file (default: xyz)"


def machine(g: Any, chips: Sequence[str] = ALL) -> None:
    others = ", or one that another package brings, see `stage chips`; or x=CHIP,y=CHIP" if chips is ALL else ""
    known = f"chip on every axis: {', '.join(chips)}{others} (default: {chips[0]})"
    g.add_argument("--chips", default=chips[0], help=known)
    g.add_argument("--motor", help="motor on every axis (default: 17HS4401)")
    g.add_argument("--microsteps", type=int, default=16, help="microsteps per full step (default: 16)")
    g.add_argument("--bus-voltage", type=VOLTAGE, default=24.0, help="drive supply, V (default: 24)")
    g.add_argument("--bus-cycle", type=TIME, default=1e-6, help="seconds a host's bus cycle takes (default: 1e-6)")
    g.add_argument(
        "--wiring",
        action="append",
        default=[],
        metavar="AXIS.SENSOR=LOGIC",
        help="the logic of a sensor, where it is not negative: x.org=positive is high while it is on; ez is the encoder's index",
    )
    g.add_argument(
        "--multichip",
        metavar="AXIS,AXIS",
        help="wire the multichip lines of MCX514 and MCX512 together: an axis of each chip, x,z (see docs/nova.md)",
    )
    g.add_argument(
        "--syni",
        action="append",
        default=[],
        metavar="FOLLOWER=LEADER",
        help="connect SYNI of an axis' chip (PCL-240 family) to SYNO of another's: y=x, or y=x,z=x",
    )


def outputs(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("output")
    g.add_argument("--record", metavar="FILE.rrd", help="write a rerun recording")
    g.add_argument("--picture", metavar="FILE.png", help="render the recording's dashboard, no screen needed")
    g.add_argument("--vcd", metavar="FILE.vcd", help="write waveforms for GTKWave")
    g.add_argument("--force", action="store_true", help="overwrite files that exist")
    g.add_argument("--view", action="store_true", help="open the recording in the rerun viewer")
    g.add_argument("--web", action="store_true", help="serve the dashboard to a browser, on 127.0.0.1 only")
    g.add_argument("--port", type=port, default=9090, action=Given, help="port for --web (default: 9090)")


def speeds(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("speeds (pulses per second; the nearest that the registers reach is used and printed)")
    g.add_argument("--fl", type=RATE, help="FL: start and stop rate")
    g.add_argument("--fh1", type=RATE, help="FH1: first high rate")
    g.add_argument("--fh2", type=RATE, help="FH2: second high rate")
    g.add_argument("--accel", type=TIME, help="seconds from FL to the highest rate")
    g.add_argument("--decel", type=TIME, help="seconds back to FL (default: as --accel)")


def ramps(p: argparse.ArgumentParser) -> None:
    g = p.add_argument_group("ramps")
    g.add_argument(
        "--s-curve", nargs="?", type=float, const=True, metavar="SHARE",
        help="S-curves; with SHARE (above 0, up to 0.5) that part of the ramp is curved at each end (needs PCL240MS)",
    )  # fmt: skip
    g.add_argument(
        "--automatic", action=argparse.BooleanOptionalAction,
        help="let the chip find the ramp-down point (PCL240MK, PCL240MS)",
    )  # fmt: skip


def place(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        "--from",
        dest="start",
        metavar="PLACE",
        help="where the carriage starts: 20mm, 30deg; without a unit mm, degrees on a hinge (default: 0)",
    )


def plot(p: argparse.ArgumentParser) -> None:
    p.add_argument("--plot", metavar="FILE.png", help="draw the move")


def number(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number, as 0x300 or 768") from None


def port(text: str) -> int:
    """A TCP port."""
    value = number(text)
    if not 0 <= value < 1 << 16:
        raise argparse.ArgumentTypeError(f"{text}: a TCP port is 0 (one that is free) to 65535")
    return value
