"""The command `stage pullout`."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts
from stage.cli.options import VOLTAGE
from stage.cli.output_and_progress import show_progress
from stage.cli.output_files import check_outputs, draw_plot


def add_subcommand(commands: Any) -> None:
    """Add `stage pullout` to argparse's subparsers."""
    p = add_command(
        commands, "pullout", run, "simulate the pull-out torque of a motor over speed",
        "Simulate the torque at which the motor slips at each speed, and print it next to the closed form of an ideal drive.",
        ("stage pullout --motor 17HS4401 --plot pullout.png", "draw the curve"),
        ("stage pullout --bus-voltage 48", "use a supply of 48 V"),
    )  # fmt: skip
    p.add_argument("--motor", default="17HS4401", help="stepper motor, see `stage list motors` (default: 17HS4401)")
    p.add_argument("--bus-voltage", type=VOLTAGE, default=24.0, help="supply voltage of the drive, in V (default: 24)")
    p.add_argument("--microsteps", type=int, default=16, help="microsteps per full step (default: 16)")
    options.add_plot_option(p)
    options.add_force_option(p)


def run(args: argparse.Namespace) -> int:
    """Simulate and print the pull-out curve of a motor, and compare it with the published curve."""
    from stage.drives.dynamometer import tabulate_pull_out
    from stage.drives.motors import Drive, describe_core_loss, estimate_core_loss, find_motor
    from stage.drives.published_pull_out_curves import PUBLISHED_CURVES

    drive = Drive(find_motor(args.motor), microsteps=args.microsteps, bus_voltage=args.bus_voltage)
    check_outputs(args)
    table = tabulate_pull_out(drive, progress=partial(show_progress, "simulating"))
    add_facts(args, motor=args.motor, bus_voltage=args.bus_voltage, microsteps=args.microsteps, pull_out=table)
    print(table)
    if (curve := PUBLISHED_CURVES.get(args.motor)) is not None:
        comparison = curve.compare(drive.motor)
        rms = comparison.compute_rms()
        add_facts(args, published={**comparison._asdict(), "rms_deviation": rms, "source": curve.source})
        print(f"\n{curve.source}, and simulated:\n{comparison}\nrms deviation {rms:.1%}")
    else:
        add_facts(args, likely_core_loss=estimate_core_loss(drive.motor))
        print(f"\n{describe_core_loss(drive.motor)}")
    if args.plot:
        from stage.drives.pull_out_plot import plot_pull_out

        draw_plot(args, partial(plot_pull_out, drive, table))
    return 0
