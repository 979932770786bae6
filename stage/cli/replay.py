"""The command `stage replay`."""

from __future__ import annotations

import argparse
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts
from stage.cli.output_and_progress import show_simulated_time
from stage.cli.output_files import draw_plot, record_for_plot
from stage.cli.stage_setup import make_stage, place_carriages

PLOT_INTERVAL_S = 1e-3


def add_subcommand(commands: Any) -> None:
    """Add `stage replay` to argparse's subparsers."""
    p = add_command(
        commands, "replay", replay_capture_file, "play a logic analyser's capture into STEP/DIR axes",
        "Play the STEP and DIR edges of a real controller, captured by a logic analyser (VCD of sigrok, PulseView or GTKWave), "
        "into STEP/DIR axes, each at its nanosecond. Print for each axis the steps, the positions, lost steps, the largest "
        "following error, switches, and times that were too short for the power stage. Exit code 0 if every edge was "
        "accepted and no step was lost.",
        ("stage replay capture.vcd --pins x.step=D2,x.dir=D5 --drive drv8825", "one axis, with the timing of a DRV8825"),
        ("stage replay capture.vcd --pins x.step=D2,x.dir=D5,x.limit_plus=!D9", "compare a limit switch, too"),
        ("stage replay capture.vcd --pins grbl --place x=20mm --plot run.png", "signals named as grbl's pins; draw the run"),
    )  # fmt: skip
    p.add_argument("capture", metavar="FILE.vcd", help="capture of a logic analyser; docs/replay.md")
    p.add_argument(
        "--pins", action="append", required=True, metavar="LINES",
        help="signals of the capture that are lines of axes: x.step=D2,x.dir=D5,x.enable=!D8, ! for a line that is asserted "
        "while it is low; or a board: grbl, cnc-shield-v3, ramps",
    )  # fmt: skip
    options.add_place_option(p)
    options.add_plot_option(p)
    options.add_stage_and_output_options(p)
    p.set_defaults(chips="stepdir")


def replay_capture_file(args: argparse.Namespace) -> int:
    """Feed a logic analyzer's capture file to a stage; return 0 if it has steps, all edges were accepted and no step was lost."""
    from stage.board.capture_replay import replay_capture

    stage = make_stage(args)
    place_carriages(args, stage)
    with record_for_plot(args, stage, PLOT_INTERVAL_S) as recording, show_simulated_time(stage):
        report = replay_capture(stage, args.capture, args.pins)
        print(report)
        add_facts(args, report)
        if args.plot:
            draw_plot(args, recording.plot)
    return 0 if report.ok else 1
