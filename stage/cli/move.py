"""The commands `stage move`, `stage dual-rate` and `stage sync`."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts, warn
from stage.cli.options import DURATION, RATE, TIME
from stage.cli.output_and_progress import show_simulated_time
from stage.cli.output_files import draw_plot, record_to_files
from stage.cli.stage_setup import (
    find_axis,
    find_speed_unit,
    make_stage,
    parse_distance,
    parse_speed_options,
    place_carriage,
    split_pair,
)
from stage.errors import ArgumentError, add_article


def add_subcommand(commands: Any) -> None:
    """Add `stage move`, `stage dual-rate` and `stage sync` to argparse's subparsers."""
    p = add_command(
        commands, "move", run_move, "move an axis by pulses or by a distance",
        "Move by a number of pulses, or by a distance, and stop on the last pulse. With a PCL-240 it is a preset move: R0 counts "
        "the pulses down, and the ramp-down point R6 follows from the data sheet's formula, or the chip finds it itself.",
        ("stage move x 10mm --speed 50mm/s", "move by 10 mm at 50 mm/s"),
        ("stage move x 8000 --fh1 20000", "move by 8000 pulses at 20,000 pps"),
        ("stage move x -10mm --chips hctl1100", "move a servo axis 10 mm towards minus"),
        ("stage move x 8000 --chips pcl240ms --s-curve --plot s.png", "draw a move with S-curve ramps"),
    )  # fmt: skip
    _add_axis_and_distance(p)
    p.add_argument("--constant", action="store_true", help="constant rate, no ramps (PCL-240 family)")
    options.add_start_option(p)
    options.add_speed_options(p)
    options.add_ramp_options(p)
    options.add_plot_option(p)
    options.add_stage_and_output_options(p)
    p = add_command(
        commands, "dual-rate", run_dual_rate_move, "change the rate within one move of an axis",
        "Ramp to FH1, change to FH2 in motion, change back, and stop on the last pulse. --rates sets another order of FL, FH1 and "
        "FH2: FL,FH1 is the data sheet's dual rate mode (1), which ramps up; FH1,FL is mode (2), which ramps down. Only the "
        "PCL-240 family has these modes.",
        ("stage dual-rate x 40000 --fh1 10000 --fh2 20000", "two rates in one move"),
        ("stage dual-rate x 8000 --rates FL,FH1 --dwell 0.5", "dual rate mode (1): constant FL, then a ramp up to FH1"),
        ("stage dual-rate x 8000 --rates FH1,FL", "dual rate mode (2): FH1, then a ramp down to FL"),
        ("stage dual-rate x 100mm --plot dual.png", "draw a move of 100 mm"),
    )  # fmt: skip
    _add_axis_and_distance(p)
    p.add_argument(
        "--rates",
        default="FH1,FH2,FH1",
        metavar="RATE,RATE",
        help="FL, FH1 and FH2 in any order (default: FH1,FH2,FH1)",
    )
    p.add_argument(
        "--dwell", type=TIME, default=0.1, help="seconds at each rate except the last, after its ramp (default: 0.1)"
    )
    options.add_start_option(p)
    options.add_speed_options(p, "the highest speed")
    options.add_plot_option(p)
    options.add_stage_and_output_options(p)
    p = add_command(
        commands, "sync", run_synchronized_move, "move several axes along a straight line",
        "Move several axes along a straight line. Their rates are in the ratio of the distances, their ramps take equal times, and "
        "they start one after the other. Chips with interpolation use it instead.",
        ("stage sync x=20000 y=-7500", "move two axes"),
        ("stage sync x=10mm y=-2mm z=1mm --rate 5000", "move three axes; the one with the most pulses at 5,000 pps"),
        ("stage sync x=20000 y=-7500 --chips mcx514", "use the interpolation of the chip"),
    )  # fmt: skip
    p.add_argument(
        "distances", nargs="+", metavar="AXIS=DISTANCE", help="for example x=20000 y=-7500, or x=10mm y=-2mm"
    )
    p.add_argument(
        "--speed", "--rate", dest="fh1", type=RATE, metavar="SPEED",
        help="speed of the axis with the most pulses: 5000 or 5kpps, or 20mm/s of its carriage",
    )  # fmt: skip
    p.add_argument("--fl", type=RATE, help="speed of that axis at its start and stop")
    p.add_argument("--accel", type=DURATION, help="duration of the ramps, in s")
    options.add_ramp_options(p)
    options.add_plot_option(p)
    options.add_stage_and_output_options(p)


def _add_axis_and_distance(p: argparse.ArgumentParser) -> None:
    """Add the arguments AXIS and DISTANCE to a parser."""
    p.add_argument("axis", metavar="AXIS", help="axis to move")
    p.add_argument(
        "distance", metavar="DISTANCE", help="pulses (counts of a servo), or 10mm, 30deg; the sign is the direction"
    )


def run_move(args: argparse.Namespace) -> int:
    """Move an axis; return 0 if it has moved as requested."""
    from stage import firmware

    return _run_on_axis(args, lambda axis, pulses, speeds: firmware.move(axis, pulses=pulses, speed=speeds))


def run_dual_rate_move(args: argparse.Namespace) -> int:
    """Move an axis at two rates; return 0 if it has moved as requested."""
    from stage.firmware.driver import get_driver
    from stage.firmware.procedures import move_at_two_rates

    def run(axis: Any, pulses: int, speeds: Any) -> Any:
        if "second" not in get_driver(axis).OPTIONS:
            raise ArgumentError(
                f"dual-rate: {add_article(axis.chip.MAP.chip)} has one drive speed; FH1 and FH2 are of the PCL-240 family."
            )
        return move_at_two_rates(
            axis, pulses=pulses, speed=speeds, dwell=args.dwell, rates=args.rates.upper().split(",")
        )

    return _run_on_axis(args, run)


def _run_on_axis(args: argparse.Namespace, run: Any) -> int:
    """Move the axis that the options name, and print the report; return the exit code.

    Args:
        args: Options of the command.
        run: Function of the axis, the pulses and the speeds that makes the move and returns its report.
    """
    from stage.firmware.driver import get_driver
    from stage.firmware.procedures import describe_overtravel, explain_rates_in_units

    stage = make_stage(args)
    axis = find_axis(stage, args.axis)
    for carriage in (axis, *(stage.axes[name] for name in axis.tandem)):
        place_carriage(stage, carriage, "--from", args.start)
    if axis.tandem:
        _warn_of_twisted_load(args, axis, axis.tandem, [f"{axis.name}={args.distance}"])
    with record_to_files(args, stage), show_simulated_time(stage):
        pulses, speeds = parse_distance(axis, args.distance), parse_speed_options(args, axis, "rates" not in args)
        overtravel = describe_overtravel(axis, pulses)
        with explain_rates_in_units(axis, find_speed_unit(args)):
            described = get_driver(axis).describe_speeds(speeds)
            report = run(axis, pulses, speeds)
        if overtravel:
            warn(args, overtravel)
        if described:
            print(described)
        print(report)
        print(report.listing())
        add_facts(args, reports=[report])
        draw_plot(args, report.plot)
    return 0 if report.ok else 1


def _warn_of_twisted_load(
    args: argparse.Namespace, axis: Any, axes_left_behind: Sequence[str], typed_moves: list[str]
) -> None:
    """Warn that an axis moves without other axes that drive the same load.

    Args:
        args: Options, for `warn`.
        axis: Axis that moves.
        axes_left_behind: Axes of the load that do not move as far.
        typed_moves: Moves as typed, AXIS=DISTANCE.
    """
    distance = next(value for name, value in map(split_pair, typed_moves) if name == axis.name)
    others = [move for move in typed_moves if split_pair(move)[0] not in axes_left_behind]
    warn(
        args,
        f"axis {axis.name} drives one load with {' and '.join(axes_left_behind)}, which stays behind: the load is twisted. "
        f"To move all of them: {shlex.join(['stage', 'sync', *others, *(f'{name}={distance}' for name in axes_left_behind)])}",
    )


def run_synchronized_move(args: argparse.Namespace) -> int:
    """Move several axes along a line; return 0 if they have moved as requested."""
    from stage import firmware
    from stage.firmware.driver import get_driver
    from stage.firmware.procedures import check_same_chip_kind, describe_overtravel, explain_rates_in_units

    stage = make_stage(args)
    pulses: dict[str, int] = {}
    for item in args.distances:
        name, distance = split_pair(item)
        if not (name and distance):
            raise ArgumentError(f"{item!r}: write AXIS=PULSES or AXIS=DISTANCE, for example x=20000 or x=10mm.")
        axis = find_axis(stage, name)
        if name in pulses:
            raise ArgumentError(f"{item!r}: axis {name} already has {pulses[name]} pulses. Give each axis once.")
        pulses[name] = parse_distance(axis, distance)
    overtravels = [text for name, n in pulses.items() if (text := describe_overtravel(stage.axes[name], n))]
    for name in pulses:
        if left := [other for other in stage.axes[name].tandem if pulses.get(other) != pulses[name]]:
            _warn_of_twisted_load(args, stage.axes[name], left, args.distances)
    check_same_chip_kind({name: get_driver(stage.axes[name]) for name in pulses})
    fastest = stage.axes[max(pulses, key=lambda name: abs(pulses[name]))]
    speeds = parse_speed_options(args, fastest)
    with record_to_files(args, stage), show_simulated_time(stage):
        with explain_rates_in_units(fastest, find_speed_unit(args)):
            report = firmware.line(pulses, stage.axes, pulses=True, speed=speeds)
        for text in overtravels:
            warn(args, text)
        if report.plan:
            print(report.plan)
        print(report)
        add_facts(args, report)
        draw_plot(args, report.plot)
    return 0 if report.ok else 1
