"""Objects that the options of a command describe: the stage, its board, and the moves of its axes."""

from __future__ import annotations

import argparse
import math
from typing import Any

from stage.cli import options
from stage.cli.options import SpeedOfCarriage
from stage.errors import ArgumentError, add_article, unknown_name_error
from stage.support.axis_value_parsing import (
    parse_chips,
    parse_multichip,
    parse_syni,
    parse_value_by_axis,
    parse_wiring,
    split_pair,
)
from stage.units import POSITION_FACTORS, POSITION_UNITS, explain_number_error, parse_position


def make_stage(args: argparse.Namespace, visuals: bool = True) -> Any:
    """Create the stage that the options describe.

    Args:
        args: Options of the command.
        visuals: Whether to keep the parts of the model that are only for display.
    """
    from stage import Drive, Stage
    from stage.sim import plant
    from stage.sim.chip_and_drive_assignment import find_chip_class

    by_axis = {
        name: parse_value_by_axis(f"--{name.replace('_', '-')}", str(value))
        for name in ("motor", "drive", "microsteps")
        if (value := getattr(args, name)) is not None
    }

    def make_drive(chip: Any, axis: str = "") -> Any:
        values = {name: choices.get(axis, choices.get("")) for name, choices in by_axis.items()}
        if chip.SERVO:
            return values.get("motor")
        parts: Any = {"motor": values.get("motor"), "power_stage": values.get("drive")}
        parts = {name: choice for name, choice in parts.items() if choice is not None}
        microsteps = int(values["microsteps"] or options.DEFAULT_MICROSTEPS)
        return Drive(microsteps=microsteps, bus_voltage=args.bus_voltage, **parts)

    named = {axis for choices in by_axis.values() for axis in choices if axis}
    if "=" in args.chips:
        chips: Any = {axis: find_chip_class(name) for axis, name in parse_chips(args.chips).items()}
        drives: Any = {axis: make_drive(chip, axis) for axis, chip in chips.items()}
    else:
        chips = drives = find_chip_class(args.chips)
        if named:
            drives = {axis: make_drive(chips, axis) for axis in plant.find_axis_names(plant.open_spec(args.model))}
        else:
            drives = make_drive(chips)
    for axis in sorted(named - set(drives if isinstance(drives, dict) else ())):
        raise unknown_name_error("axis", axis, drives)
    return Stage(
        args.model, chips=chips, drives=drives, bus_cycle=args.bus_cycle, clock=getattr(args, "clock", None),
        encoders=[parse_encoder(item) for item in getattr(args, "encoder", ())], wiring=parse_wiring(args.wiring),
        multichip=parse_multichip(args.multichip), syni=parse_syni(args.syni), visuals=visuals,
    )  # fmt: skip


def make_board(args: argparse.Namespace) -> Any:
    """Create the board that the options describe, with its carriages at the positions of --place."""
    from stage.board import Board

    stage = make_stage(args)
    place_carriages(args, stage)
    return Board(stage, args.layout, args.base, args.stride, keep_cycles=args.keep, devices=args.device)


def place_carriages(args: argparse.Namespace, stage: Any) -> None:
    """Move carriages to the positions of --place."""
    placed = set()
    for item in args.place:
        name, place = split_pair(item)
        if not (name and place):
            raise ArgumentError(f"--place {item!r}: write AXIS=PLACE, for example x=62mm.")
        if name in placed:
            raise ArgumentError(f"--place {item!r}: axis {name} already has a place. Give each axis once.")
        place_carriage(stage, find_axis(stage, name), f"--place {name}", place)
        placed.add(name)


def parse_encoder(item: str) -> Any:
    """Parse the value of --encoder, for example x=2000/turn.

    Raises:
        ArgumentError: The text has no axis, or no number of counts other than 0.
    """
    from stage.sim.encoder import Encoder

    axis, text = split_pair(item)
    number, per, turn = text.partition("/")
    try:
        counts = float(number)
    except ValueError:
        counts = 0.0
    if not axis or not counts or not math.isfinite(counts) or (per and turn != "turn"):
        raise ArgumentError(
            f"--encoder {item!r}: write AXIS=COUNTS, counts per meter other than 0, for example x=200000; or per turn of the "
            "motor, x=2000/turn."
        )
    return Encoder(axis, per_turn=counts) if per else Encoder(axis, per_metre=counts)


# --- moves ---

SPEED_OPTIONS = {
    "fl": "start_speed", "fh1": "speed", "accel": "accel", "decel": "decel", "s_curve": "s_curve",
    "fh2": "second", "constant": "constant", "automatic": "automatic", "fast_only": "approach",
}  # fmt: skip
"""Options of the command line, and those of `parse_speeds`; the last four are not of every family."""


def parse_speed_options(args: argparse.Namespace, axis: Any, ramps_end_at_drive: bool = False) -> Any:
    """Return the `Speeds` that the options set for an axis.

    Args:
        args: Options of the command.
        axis: Axis that moves.
        ramps_end_at_drive: Whether --accel and --decel are the times of the ramps to FH1, even if FH2 is higher.

    Raises:
        ArgumentError: The axis' chip does not support one of the options.
    """
    from stage.firmware.driver import get_driver
    from stage.firmware.procedures import explain_rates_in_units, parse_speeds

    driver, chip = get_driver(axis), add_article(axis.chip.MAP.chip)
    values = {name: value for name in SPEED_OPTIONS if (value := getattr(args, name, None)) not in (None, False)}
    for name in ("fh2", "constant", "automatic", "fast_only"):
        if name in values and SPEED_OPTIONS[name] not in driver.OPTIONS:
            option = name.replace("_", "-")
            raise ArgumentError(
                f"--{option}: {chip} does not have this option; only the PCL-240 family does. Leave it out."
            )
    if values.get("s_curve", True) is not True and "s_curve_share" not in driver.OPTIONS:
        raise ArgumentError(
            f"--s-curve {args.s_curve:g}: {chip} cannot set the share of an S-curve. Give --s-curve alone."
        )
    options = {SPEED_OPTIONS[name]: _convert_speed(axis, name, value) for name, value in values.items()}
    options["automatic"] = getattr(args, "automatic", None)
    if "fast_only" in values:
        options["approach"] = 0.0
    with explain_rates_in_units(axis, find_speed_unit(args)):
        speeds = parse_speeds(axis, options, in_pulses=True)
        if "fh2" in args and "fh2" not in values:
            second = driver.get_default_second_rate(speeds.drive)
            if second is not None:
                speeds = parse_speeds(axis, options | {"second": second}, in_pulses=True)
        if ramps_end_at_drive and speeds.second and speeds.second > speeds.drive > speeds.start:
            steeper = (speeds.second - speeds.start) / (speeds.drive - speeds.start)
            up, down = "accel" in values, "accel" in values or "decel" in values
            speeds = speeds._replace(
                up=speeds.up * (steeper if up else 1.0), down=speeds.down * (steeper if down else 1.0)
            )
    return speeds


def find_speed_unit(args: argparse.Namespace) -> str:
    """Return the unit in which the user has typed a speed of the carriage, for example "mm/s"; "" for pulse rates."""
    typed = (getattr(args, name, None) for name in ("fh1", "fl", "fh2"))
    return next((value.symbol for value in typed if isinstance(value, SpeedOfCarriage)), "")


def _convert_speed(axis: Any, name: str, value: Any) -> Any:
    """Return the value of a speed option in pps; values of other options stay as they are."""
    if not isinstance(value, SpeedOfCarriage):
        return value
    if value.unit != axis.unit:
        example = "30deg/s" if axis.unit == "rad" else "50mm/s"
        raise ArgumentError(
            f"--{name} {value.text}: axis {axis.name} moves in {POSITION_UNITS[axis.unit].symbol}. Give a speed such as {example}."
        )
    return value.value / axis.meters_per_pulse


def parse_distance(axis: Any, text: str) -> int:
    """Return the pulses of a typed distance: 8000 (pulses), 10mm, -0.5deg.

    Raises:
        ArgumentError: The text is no integer, and no distance in a unit of the axis.
    """
    from stage.firmware.procedures import convert_to_pulses

    text = text.strip()
    try:
        return convert_to_pulses(axis, None, int(text, 0))
    except ValueError:
        distance = parse_position(text, axis.unit) if text.endswith(tuple(POSITION_FACTORS[axis.unit])) else None
    if distance is not None and not math.isfinite(distance):
        raise ArgumentError(f"{text!r} is not a finite number. Give axis {axis.name} a distance such as 10mm.")
    if distance is None:
        raise ArgumentError(
            f"{text!r}: give a whole number of pulses for axis {axis.name}, such as 8000, or a distance in "
            f"{', '.join(POSITION_FACTORS[axis.unit])}, such as 10{POSITION_UNITS[axis.unit].symbol}.{explain_number_error(text)}"
        )
    return convert_to_pulses(axis, distance, None)


def find_axis(stage: Any, name: str) -> Any:
    """Return the axis with a name.

    Raises:
        ArgumentError: The stage has no such axis; the error lists similar names.
    """
    if name not in stage.axes:
        raise unknown_name_error("axis", name, stage.axes)
    return stage.axes[name]


def place_carriage(stage: Any, axis: Any, option: str, place: str | None) -> None:
    """Move the carriage of an axis to a position.

    Args:
        stage: Stage of the axis.
        axis: Axis to move.
        option: Option that names the position, for errors.
        place: Position such as 62mm or 90deg, or a number of mm (degrees on a hinge); None: do not move the carriage.

    Raises:
        ArgumentError: The text is no position, or is outside the travel of the axis.
    """
    if place is None:
        return
    unit, (low, high) = POSITION_UNITS[axis.unit], axis.travel
    place = place.strip()
    position = parse_position(place, axis.unit)
    if position is None:
        raise ArgumentError(
            f"{option} {place}: give a position on axis {axis.name} in {unit.symbol}, or with a unit: "
            f"{', '.join(POSITION_FACTORS[axis.unit])}.{explain_number_error(place)}"
        )
    slack = 1e-9 * (high - low)
    if not low - slack <= position <= high + slack:
        raise ArgumentError(
            f"{option} {place}: axis {axis.name} travels from {low * unit.factor:g} to {unit.format(high, 'g')}."
        )
    stage.place(**{axis.name: min(max(position, low), high)})
