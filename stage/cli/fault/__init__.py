"""The command `stage fault`: it makes one fault, and runs the same program on a healthy and on a faulty stage.

A demonstration consists of a host program with a fault (host_programs.py), the values that the program measures, and the claim
about them (demonstrations.py).
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts
from stage.cli.output_files import check_outputs, draw_plot, record_for_plot
from stage.cli.stage_setup import make_stage

SAMPLE_INTERVAL_S = 2.5e-4
"""Simulated seconds between the samples of a picture."""


def add_subcommand(commands: Any) -> None:
    """Add `stage fault` to argparse's subparsers."""
    p = add_command(
        commands, "fault", run, "show the effect of a fault: a switch, a wire, the supply, the bus",
        "Run a program on a healthy stage and on a faulty one, and print what differs. Without a name, list the faults. "
        "Recordings show the faulty run. The exit code is 0 if the claimed effect occurs.",
        ("stage fault", "list the faults"),
        ("stage fault jam --plot jam.png", "draw a healthy axis and one that jams"),
        ("stage fault bounce --chips mcx514 --record bounce.rrd", "record the run with a switch that bounces"),
    )  # fmt: skip
    name = p.add_argument("name", nargs="?", metavar="NAME", help="fault to show, such as jam (default: list them all)")
    name.list_names = _list_faults  # type: ignore[attr-defined]
    options.add_plot_option(p)
    options.add_stage_and_output_options(p)


def _list_faults(_: argparse.Namespace) -> list[str]:
    """List the names of the faults, for a shell that completes."""
    from stage.cli.fault import demonstrations

    return list(demonstrations.DEMOS)


def run(args: argparse.Namespace) -> int:
    """List the faults, or demonstrate one; return 0 if it happens as claimed."""
    from stage.cli.fault import demonstrations

    if args.name is None:
        claims = {name: demo.claim for name, demo in demonstrations.DEMOS.items()}
        add_facts(args, claims)
        width = max(map(len, claims)) + 2
        print("\n".join(f"{name:{width}}{claim}" for name, claim in claims.items()))
        return 0
    demonstrations.find_demonstration_key(args.name)
    check_outputs(args)
    record = partial(record_for_plot, args, interval=SAMPLE_INTERVAL_S)
    result = demonstrations.run_demonstration(args.name, partial(make_stage, args), record, args.plot is not None)
    print(
        f"{result.name}: {result.demo.claim}\n\n{result.format_table()}\n\nHow a host can detect it: {result.demo.notice}"
    )
    healthy, faulty = result.figures
    add_facts(
        args, fault=result.name, claim=result.demo.claim, notice=result.demo.notice, as_claimed=result.as_claimed,
        unit=result.unit, healthy=healthy, faulty=faulty,
    )  # fmt: skip
    draw_plot(args, result.plot)
    print("happened as claimed" if result.as_claimed else "did NOT happen as claimed")
    return 0 if result.as_claimed else 1
