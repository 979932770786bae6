"""The programs of the demonstrations: what a host does, with any chip, by its driver; and their figures.

Distances and rates are turns of the motor, so that carriages do the same whatever a pulse is: 5 turns are 16,000 pulses of a drive
with 16 microsteps, 10,000 counts of a servo's encoder.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from stage.cli.fault.demo import Figures, Strike
from stage.errors import StageError, a_or_an

if TYPE_CHECKING:
    from stage.firmware.driver import Speeds

START = 0.3125  # turns/s, 1000 pps
CONTACT = 3e-3  # s that a contact bounces
PATIENCE = 60.0  # s for a move


def first_axis(stage: Any) -> Any:
    """The axis on which it is shown."""
    return next(iter(stage.axes.values()))


def touch(axis: Any, pin: str) -> float:
    """The position at which the axis trips a switch, m. Raises StageError where it has none, or its chip has no pin for it."""
    if not axis.chip.wired(pin):
        raise StageError(
            f"axis {axis.name}: {a_or_an(type(axis.chip).__name__)} has no pin for {pin}, which is to fail: take a chip that "
            "has one."
        )
    for switch in axis.plant.switches:
        if switch.pin == pin:
            return switch.touch
    raise StageError(
        f"axis {axis.name} has no switch {pin}, which is to fail: take a model that has it, for example xyz."
    )


def pulses(axis: Any, turns: float) -> int:
    """Pulses, or counts, of so many turns."""
    return round(turns * axis.drive.pulses_per_turn)


def speeds(axis: Any, drive: float, ramp: float, start: float = START) -> Speeds:
    """From turns/s and s."""
    from stage.firmware.driver import Speeds

    turn = axis.drive.pulses_per_turn
    return Speeds(start * turn, drive * turn, ramp, ramp)


def begin(axis: Any, turns: float, *how: float) -> Callable[[], Figures]:
    """Start a move, how: see `speeds`. Returns a function that waits for its end, and for the motor, and gives the figures."""
    from stage.firmware.driver import driver_of

    driver = driver_of(axis)
    lost, worst, servo = axis.lost_steps, 0.0, driver.has_position_loop
    driver.start(pulses(axis, turns), speeds(axis, *how))
    start, net = axis.position, axis.chip.net(axis.chip_axis)

    def look() -> None:
        nonlocal worst
        worst = max(worst, abs(axis.commanded - axis.position))

    def finish() -> Figures:
        ended = driver.wait(PATIENCE, look if servo else None)
        behind = axis.commanded - axis.position
        axis.wait(0.3)
        figures = {
            "stopped by": ended,
            "counts commanded" if servo else "pulses made": axis.chip.net(axis.chip_axis) - net,
            "carriage moved, mm": (axis.position - start) * 1e3,
        }
        if servo:
            return figures | {"behind at most, mm": worst * 1e3, "behind at the end, mm": behind * 1e3}
        return figures | {"lost steps": axis.lost_steps - lost}

    return finish


def stuck_open(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = first_axis(stage)
    stage.place(**{x.name: touch(x, "el_plus") - 0.010})
    with strike(faults.switch_stuck, x, "el_plus", False):
        return begin(x, 5, 3.125, 0.05)() | {"beyond EL+, mm": (x.position - touch(x, "el_plus")) * 1e3}


def stuck_closed(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = first_axis(stage)
    finish = begin(x, 10, 6.25, 0.1)
    x.wait(0.5)
    with strike(faults.switch_stuck, x, "el_plus", True):
        return finish() | {"before EL+, mm": (touch(x, "el_plus") - x.position) * 1e3}


def bounce(stage: Any, strike: Strike) -> Figures:
    from stage import faults
    from stage.firmware.driver import driver_of

    x = first_axis(stage)
    with strike(faults.bounce, x, "org", CONTACT):
        stage.place(**{x.name: touch(x, "org") + 0.002})
        report = driver_of(x).home(-1, speeds(x, 5, 0.07))
    course = report.course
    org, time = course.edges["inputs"] & x.chip.wired("org") != 0, course.seconds
    first = int(org.argmax())
    seen = (time[:-1] >= time[first]) & (time[:-1] < time[first] + 1.5 * CONTACT)
    off = (time[1:] - time[:-1])[seen & ~org[:-1]]
    return {
        "edges of ORG that the chip saw": int((org[1:] != org[:-1]).sum()),
        "after the first edge ORG is off for, ms": float(off.sum()) * 1e3,
        "origin return stopped by": report.stopped_by,
        "origin, um": x.position * 1e6,
    }


def vane_missing(stage: Any, strike: Strike) -> Figures:
    from stage import faults
    from stage.firmware.driver import driver_of

    x = first_axis(stage)
    with strike(faults.vane_missing, x, "org"):
        report = driver_of(x).home(-1, speeds(x, 5, 0.07))
        return {
            "stopped by": report.stopped_by,
            "pulses made": report.pulses,
            "past ORG, mm": (touch(x, "org") - x.position) * 1e3,
            "lost steps": report.lost_steps,
        }


def payload(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = first_axis(stage)
    stage.set_payload(10.0)
    with strike(faults.payload, stage, 2.0):
        return {"payload, kg": stage.payload()} | begin(x, 10, 18.75, 0.046)()


def bus_voltage(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = first_axis(stage)
    finish = begin(x, 12.5, 18.75, 0.1, 0.46875)
    x.wait(0.3)
    with strike(faults.bus_voltage, x, 8.0):
        return finish()


def jam(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = first_axis(stage)
    finish = begin(x, 10, 6.25, 0.1)
    x.wait(0.5)
    at = x.position
    with strike(faults.jam, x):
        return finish() | {"on from 0.5 s, mm": (x.position - at) * 1e3}


def phase_open(stage: Any, strike: Strike) -> Figures:
    from stage import faults

    x = first_axis(stage)
    with strike(faults.phase_open, x, "b"):
        figures = begin(x, 5, 3.125, 0.1)()
    stage.place(**{x.name: -0.05})
    finish = begin(x, 7.5, 6.25, 0.1)
    x.wait(0.5)
    with strike(faults.phase_open, x, "b"):
        return figures | {"opened at 6.25 turns/s: lost steps": finish().get("lost steps")}  # a servo: refused


def start_skew(stage: Any, strike: Strike) -> Figures:
    """The axis that goes the longest way is named last: then it is started last."""
    from stage import faults
    from stage.firmware.driver import driver_of

    late = first_axis(stage)
    other = _started_apart(stage, late)
    axes = {other.name: driver_of(other), late.name: driver_of(late)}
    ways = {other.name: pulses(other, -2.34375), late.name: pulses(late, 6.25)}
    with strike(faults.start_skew, late, 5e-3):
        report = driver_of(late).line(axes, ways, speeds(late, 6.25, 0.15))
    return {
        "done": "yes" if report.ok else "no",
        "started within, ms": report.skew * 1e3,
        "off the line, pulses": float(report.deviation.pulses),
        "carriages off the line, um": (report.carriage_deviation or 0.0) * 1e6,
        "finished within, ms": report.finish * 1e3,
    }


def _started_apart(stage: Any, axis: Any) -> Any:
    """An axis that a line with `axis` starts by another command. Raises StageError, with the reason, where there is none."""
    from stage.firmware.driver import driver_of

    chip = axis.chip.MAP.chip
    if driver_of(axis).has_position_loop:
        raise StageError(
            f"start-skew: no command starts the axes of a line with {chip}s: the host leads each by command positions, sample by "
            "sample. Show it with chips that make pulses."
        )
    others = [other for other in stage.axes.values() if other is not axis]
    if not others:
        raise StageError("start-skew: a line is of two axes, and the model has one. Take another, for example xyz.")
    for other in others:
        if other.chip is not axis.chip:
            return other
    raise StageError(
        f"start-skew: one command starts all axes of a line, which are one {chip}'s: nothing comes between. Show it with "
        "a chip for each axis, as the PCL-240 is."
    )


def lost_write(stage: Any, strike: Strike) -> Figures:
    from stage import faults
    from stage.firmware.driver import driver_of

    x = first_axis(stage)
    turns = min(5, 0.9 * (x.travel[1] - x.position) * abs(x.gear) / (2 * math.pi))
    asked, register = pulses(x, turns), driver_of(x).FINISH
    written, nothing = (x.chip.register_cycles(register, distance, x.chip_axis) for distance in (asked, 0))
    address, value = next(cycle for cycle, other in zip(written, nothing, strict=True) if cycle != other)
    with strike(faults.lost_write, x, address, value):
        return {"asked": asked} | begin(x, turns, 3.125, 0.1)() | {"diagnostics": len(x.chip.diagnostics)}
