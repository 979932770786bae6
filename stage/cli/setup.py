"""What the moving commands share: the stage, the axes and the numbers that the options describe."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from typing import Any

from stage.cli.facts import warn
from stage.errors import ArgumentError, unknown
from stage.units import PLACES, TYPED, slip, typed


def make_stage(args: argparse.Namespace, visuals: bool = True) -> Any:
    """The stage that the options describe; visuals: with what is only for display."""
    from stage import Drive, Stage
    from stage.chips import chip_class

    common: dict[str, Any] = {"bus_cycle": args.bus_cycle, "clock": getattr(args, "clock", None), "visuals": visuals}
    common["encoders"] = [_encoder(item) for item in getattr(args, "encoder", ())]
    common["wiring"] = wiring_of(getattr(args, "wiring", ()))
    common["multichip"] = multichip_of(getattr(args, "multichip", None))
    common["syni"] = syni_of(getattr(args, "syni", ()))
    motor = {} if args.motor is None else {"motor": args.motor}

    def drive(chip: Any) -> Any:
        if chip.SERVO:
            return args.motor
        return Drive(microsteps=args.microsteps, bus_voltage=args.bus_voltage, **motor)

    if "=" in args.chips:
        chips = {axis: chip_class(name) for axis, name in chips_of(args.chips).items()}
        drives = {axis: drive(chip) for axis, chip in chips.items()}
        return Stage(args.model, chips=chips, drives=drives, **common)
    chip = chip_class(args.chips)
    return Stage(args.model, chips=chip, drives=drive(chip), **common)


def chips_of(text: str) -> dict[str, str]:
    """The chip of each axis, of --chips x=pcl240ms,y=mcx304. Raises ArgumentError."""
    found: dict[str, str] = {}
    for axis, name in split_pairs(text):
        if not axis or not name:
            raise ArgumentError(
                f"--chips {text}: write one chip for all axes, or AXIS=CHIP,AXIS=CHIP: x=pcl240ms,y=mcx304."
            )
        if axis in found:
            raise ArgumentError(f"--chips {text}: axis {axis} is given two chips.")
        found[axis] = name
    return found


def split_pair(item: str) -> tuple[str, str]:
    """Split AXIS=VALUE at its last =, as the name of an axis may have one and no value has. Without = the name is empty."""
    name, _, value = item.rpartition("=")
    return name, value


def split_pairs(text: str) -> list[tuple[str, str]]:
    """Split AXIS=VALUE,AXIS=VALUE; a comma before the = of a pair is one of the axis' name."""
    pairs, name = [], ""
    for part in text.split(","):
        if "=" in part:
            axis, value = split_pair(name + part)
            pairs.append((axis.strip(), value.strip()))
            name = ""
        else:
            name += f"{part},"
    return [*pairs, ("", name)] if name else pairs


def _encoder(item: str) -> Any:
    """The encoder that --encoder describes. Raises ArgumentError."""
    from stage.sim.encoder import Encoder

    axis, text = split_pair(item)
    number, per, turn = text.partition("/")
    try:
        counts = float(number)
    except ValueError:
        counts = 0.0
    if not axis or not counts or not math.isfinite(counts) or (per and turn != "turn"):
        raise ArgumentError(
            f"--encoder {item!r}: write AXIS=COUNTS, counts a metre and not 0, for example x=200000; or of the motor x=2000/turn."
        )
    return Encoder(axis, per_turn=counts) if per else Encoder(axis, per_metre=counts)


def wiring_of(items: Iterable[str]) -> dict[str, dict[str, str]]:
    """The wiring that --wiring describes. Raises ArgumentError."""
    wiring: dict[str, dict[str, str]] = {}
    for item in items:
        where, logic = split_pair(item)
        axis, _, sensor = where.rpartition(".")
        if not (axis and sensor and logic):
            raise ArgumentError(f"--wiring {item!r}: write AXIS.SENSOR=LOGIC, for example x.org=positive.")
        wiring.setdefault(axis, {})[sensor] = logic
    return wiring


def multichip_of(text: str | None) -> list[str] | None:
    """The axes that --multichip names. Raises ArgumentError."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ArgumentError(f"--multichip {text!r}: write an axis of each chip, AXIS,AXIS, for example x,z.")
    return names


def syni_of(items: Iterable[str]) -> dict[str, str]:
    """The follower -> leader pairs that --syni gives. Raises ArgumentError."""
    pairs: dict[str, str] = {}
    text = ",".join(items)
    for follower, leader in split_pairs(text) if items else ():
        if not (follower and leader):
            raise ArgumentError(f"--syni {text!r}: write FOLLOWER=LEADER, for example y=x, or y=x,z=x.")
        if follower in pairs:
            raise ArgumentError(
                f"--syni {text!r}: axis {follower} follows {pairs[follower]} already. Give a follower once."
            )
        pairs[follower] = leader
    return pairs


def make_board(args: argparse.Namespace) -> Any:
    """The board that the options describe, with its carriages where --place says."""
    from stage.board import Board

    stage = make_stage(args)
    placed = set()
    for item in args.place:
        name, text = split_pair(item)
        if not (name and text):
            raise ArgumentError(f"--place {item!r}: write AXIS=PLACE, for example x=62mm.")
        if name in placed:
            raise ArgumentError(f"--place {item!r}: axis {name} has got a place already. Give an axis once.")
        place(stage, find_axis(stage, name), f"--place {name}", text)
        placed.add(name)
    return Board(stage, args.layout, args.base, args.stride, keep_cycles=args.keep, devices=args.device)


SPEEDS = {"fl": "start", "fh1": "drive", "fh2": "second", "accel": "up", "decel": "down"}
"""Options, and the names of the speeds that they state, see `Driver.complete_speeds`."""


def speeds(args: argparse.Namespace, axis: Any, s_curve: bool | float = False) -> Any:
    """Return the `Speeds` that the options state. Raises ArgumentError for what is not above 0, or what the chip does not have."""
    from stage.firmware.driver import driver_of

    given = {name: value for option, name in SPEEDS.items() if (value := getattr(args, option, None)) is not None}
    for option, name in SPEEDS.items():
        if name in given and not 0 < given[name] < math.inf:
            finite = "" if math.isfinite(given[name]) else ", and finite"
            raise ArgumentError(f"--{option} {given[name]:g}: more than 0{finite}.")
    return driver_of(axis).complete_speeds(**given, s_curve=s_curve)


def distance(axis: Any, text: str) -> int:
    """Pulses of a distance as it is typed: 8000 (pulses), 10mm, -0.5deg. Raises ArgumentError."""
    from stage.firmware.procedures import pulses_of

    text = text.strip()
    try:
        return pulses_of(axis, None, int(text, 0))
    except ValueError:
        way = typed(text, axis.unit) if text.endswith(tuple(TYPED[axis.unit])) else None
    if way is None:
        raise ArgumentError(
            f"{text!r}: axis {axis.name} goes a whole number of pulses, or a distance in {', '.join(TYPED[axis.unit])}: 8000, or "
            f"10{PLACES[axis.unit].symbol}.{slip(text)}"
        )
    return pulses_of(axis, way, None)


def told_of_its_end(args: argparse.Namespace, axis: Any, pulses: int) -> int:
    """`pulses`; a warning where they lead beyond the end limits of the axis, or its travel where it has none."""
    ends = {s.pin: s.touch for s in axis.plant.switches}
    low, high = (-math.inf, math.inf) if axis.unit == "rad" else axis.travel  # a hinge without limits turns without end
    low, high = ends.get("el_minus", low), ends.get("el_plus", high)
    goal = axis.position + pulses * axis.meters_per_pulse * math.copysign(1.0, axis.gear)
    slack = abs(axis.meters_per_pulse)
    if not low - slack <= goal <= high + slack:
        unit = PLACES[axis.unit]
        warn(
            args,
            f"axis {axis.name} reaches from {low * unit.per:g} to {unit.text(high, 'g')}, and this move goes to "
            f"{unit.text(goal, '.4g')}.",
        )
    return pulses


def find_axis(stage: Any, name: str) -> Any:
    if name not in stage.axes:
        raise unknown("axis", name, stage.axes)
    return stage.axes[name]


def place(stage: Any, axis: Any, option: str, where: str | None) -> None:
    """Put the carriage of `axis` where `option` says: 62mm, 90deg, or a number of mm, degrees on a hinge.

    Raises ArgumentError for what is no place, or outside its travel."""
    if where is None:
        return
    unit, (low, high) = PLACES[axis.unit], axis.travel
    where = where.strip()
    found = typed(where, axis.unit)
    if found is None:
        raise ArgumentError(
            f"{option} {where}: a place on axis {axis.name} is a number of {unit.symbol}, or in {', '.join(TYPED[axis.unit])}."
            f"{slip(where)}"
        )
    slack = 1e-9 * (high - low)
    if not low - slack <= found <= high + slack:
        raise ArgumentError(
            f"{option} {where}: axis {axis.name} travels from {low * unit.per:g} to {unit.text(high, 'g')}."
        )
    stage.place(**{axis.name: min(max(found, low), high)})
