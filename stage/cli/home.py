"""The command `stage home`."""

from __future__ import annotations

import argparse
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts
from stage.cli.options import parse_positive_integer
from stage.cli.output_and_progress import show_simulated_time, show_status
from stage.cli.output_files import draw_plot, record_to_files
from stage.cli.stage_setup import find_axis, find_speed_unit, make_stage, parse_speed_options, place_carriage
from stage.errors import ArgumentError, add_article


def add_subcommand(commands: Any) -> None:
    """Add `stage home` to argparse's subparsers."""
    p = add_command(
        commands, "home", run, "find the origin switches of axes (origin return)",
        "Find the origin switch ORG: approach it fast (SD slows the axis down), back off, and approach it again slowly.",
        ("stage home", "all axes, one after the other"),
        ("stage home x --from 62mm --plot home.png", "from 62 mm, drawn like the data sheet's operation patterns"),
        ("stage home x --chips mcx514 --by index", "end at the encoder's index pulse after the switch"),
    )  # fmt: skip
    p.add_argument("axes", nargs="*", metavar="AXIS", help="axes to home, one after the other (default: all)")
    p.add_argument("--plus", action="store_true", help="search towards plus (default: towards minus)")
    p.add_argument("--constant", action="store_true", help="search at the constant rate FL (PCL-240 family)")
    p.add_argument(
        "--fast-only", action="store_true", help="end after the fast approach, without a second one (PCL-240 family)"
    )
    p.add_argument(
        "--by", metavar="HOW",
        help="where to end: switch, index (the encoder's index pulse after the switch), or a method of the chip, such as stall",
    )  # fmt: skip
    p.add_argument(
        "--ez",
        type=parse_positive_integer,
        metavar="N",
        help="end at the N-th index pulse after ORG (N > 1: PCL240MK, PCL240MS)",
    )
    options.add_start_option(p)
    options.add_speed_options(p, "the highest speed")
    options.add_plot_option(p)
    options.add_stage_and_output_options(p)


def run(args: argparse.Namespace) -> int:
    """Home axes, those that drive one load together; return 0 if each has found its origin and no step is lost."""
    from stage.firmware.driver import get_driver
    from stage.firmware.gantry_homing import group_tandem_axes
    from stage.firmware.procedures import explain_rates_in_units

    stage = make_stage(args)
    groups = group_tandem_axes([find_axis(stage, name) for name in args.axes] or stage.axes.values())
    axes = [axis for group in groups for axis in group]
    for axis in axes:
        place_carriage(stage, axis, "--from", args.start)
    reports = []
    with record_to_files(args, stage), show_simulated_time(stage):
        for group in groups:
            names = " and ".join(axis.name for axis in group)
            show_status(f"axis {names}: origin return ...")
            if len(group) > 1:
                print(
                    f"axes {names} drive one load: together to where one meets ORG, then each to its own, as reported"
                )
            with explain_rates_in_units(group[0], find_speed_unit(args)):
                found = _home_together(args, group, names) if len(group) > 1 else [_home_axis(args, group[0])]
            reports += found
            print(*found, sep="\n")
        add_facts(args, reports=reports)
        draw_plot(args, reports[0].plot)
    found = [r.stopped_by in get_driver(axis).HOME_REASONS for r, axis in zip(reports, axes, strict=True)]
    return 0 if all(found) and not any(r.lost_steps for r in reports) else 1


def _home_axis(args: argparse.Namespace, axis: Any) -> Any:
    """Home one axis as the options say, and return the report."""
    from stage import firmware
    from stage.firmware.driver import get_driver

    last = get_driver(axis).INDEX_PULSES
    if args.ez and args.ez > last:
        pulses = "1" if last == 1 else f"1 to {last}"
        raise ArgumentError(
            f"--ez {args.ez}: {add_article(axis.chip.MAP.chip)} ends at ORG, or at index pulse {pulses} after it."
        )
    speeds = parse_speed_options(args, axis)
    return firmware.home(axis, +1 if args.plus else -1, index=args.ez or 0, speed=speeds, by=args.by)


def _home_together(args: argparse.Namespace, axes: list[Any], names: str) -> list[Any]:
    """Home axes that drive one load together, and return their reports.

    Args:
        args: Options of the command.
        axes: The axes.
        names: Names of the axes, for messages.
    """
    from stage.firmware.gantry_homing import square_gantry_at_speeds

    for option in ("by", "ez", "constant", "fast_only", "fh2"):
        if getattr(args, option) not in (None, False):
            raise ArgumentError(
                f"--{option.replace('_', '-')}: axes {names} drive one load; they go to their origin switches together."
            )
    return square_gantry_at_speeds(axes, +1 if args.plus else -1, parse_speed_options(args, axes[0]))
