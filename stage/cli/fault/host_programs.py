"""Host programs of the demonstrations: each drives a stage through its host drivers, with any chip, and returns measured values.

Distances and rates are in turns of the motor, so that a carriage moves alike whatever the length of a pulse is: 5 turns are 16,000
pulses of a drive with 16 microsteps, or 10,000 counts of a servo's encoder.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from stage import faults, firmware
from stage.errors import StageError, add_article
from stage.firmware.driver import Speeds, get_driver

if TYPE_CHECKING:
    from stage.cli.fault.demonstrations import MakeFault, MeasuredValues

START_TURNS_PER_S = 0.3125  # 1000 pps
BOUNCE_S = 3e-3
TIMEOUT_S = 60.0


def get_first_axis(stage: Any) -> Any:
    """Return the axis on which the faults are demonstrated."""
    return next(iter(stage.axes.values()))


def find_switch_position(axis: Any, pin: str) -> float:
    """Return the position at which an axis trips a switch, m.

    Raises:
        StageError: The axis has no such switch, or its chip has no pin for it.
    """
    if not axis.chip.find_switch_input(pin):
        raise StageError(
            f"axis {axis.name}: {add_article(type(axis.chip).__name__)} has no pin for {pin}, which is to fail. Choose a "
            "chip that has one."
        )
    for switch in axis.plant.switches:
        if switch.pin == pin:
            return switch.touch
    raise StageError(
        f"axis {axis.name} has no switch {pin}, which is to fail. Choose a model that has it, for example xyz."
    )


def convert_revolutions_to_pulses(axis: Any, turns: float) -> int:
    """Return the pulses, or encoder counts, for a number of turns of the motor."""
    return round(turns * axis.drive.pulses_per_turn)


def make_speeds(axis: Any, drive: float, ramp: float, start: float = START_TURNS_PER_S) -> Speeds:
    """Return the speeds of a move in pulses per second.

    Args:
        axis: Axis that moves.
        drive: Drive speed, turns of the motor per second.
        ramp: Duration of each ramp, s.
        start: Start speed, turns of the motor per second.
    """
    turn = axis.drive.pulses_per_turn
    return Speeds(start * turn, drive * turn, ramp, ramp)


def start_move(axis: Any, turns: float, *speeds: float) -> Callable[[], MeasuredValues]:
    """Start a move, and return a function that waits for its end and returns the measured values.

    Args:
        axis: Axis that moves.
        turns: Distance in turns of the motor.
        speeds: Arguments of `make_speeds`.
    """
    driver = get_driver(axis)
    lost, worst, servo = axis.lost_steps, 0.0, driver.has_position_loop
    driver.start(convert_revolutions_to_pulses(axis, turns), make_speeds(axis, *speeds))
    start, net = axis.position, axis.chip.net(axis.chip_axis)

    def measure_error() -> None:
        """Store the largest following error so far."""
        nonlocal worst
        worst = max(worst, abs(axis.commanded - axis.position))

    def finish() -> MeasuredValues:
        """Wait for the end of the move and for the motor to settle; return the measured values."""
        stopped_by = driver.wait(TIMEOUT_S, measure_error if servo else None)
        lag = axis.commanded - axis.position
        axis.wait(0.3)
        figures = {
            "stopped by": stopped_by,
            "counts commanded" if servo else "pulses made": axis.chip.net(axis.chip_axis) - net,
            "carriage moved, mm": (axis.position - start) * 1e3,
        }
        if servo:
            return figures | {"behind at most, mm": worst * 1e3, "behind at the end, mm": lag * 1e3}
        return figures | {"lost steps": axis.lost_steps - lost}

    return finish


def run_into_stuck_open_limit(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Move into EL+, which is stuck open."""
    x = get_first_axis(stage)
    stage.place(**{x.name: find_switch_position(x, "el_plus") - 0.010})
    with make_fault(faults.switch_stuck, x, "el_plus", False):
        return start_move(x, 5, 3.125, 0.05)() | {
            "beyond EL+, mm": (x.position - find_switch_position(x, "el_plus")) * 1e3
        }


def move_with_stuck_closed_limit(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Make a move during which EL+ sticks closed."""
    x = get_first_axis(stage)
    finish = start_move(x, 10, 6.25, 0.1)
    x.wait(0.5)
    with make_fault(faults.switch_stuck, x, "el_plus", True):
        return finish() | {"before EL+, mm": (find_switch_position(x, "el_plus") - x.position) * 1e3}


def home_with_bouncing_origin(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Home while the contact of ORG bounces."""
    x = get_first_axis(stage)
    with make_fault(faults.bounce, x, "org", BOUNCE_S):
        stage.place(**{x.name: find_switch_position(x, "org") + 0.002})
        report = firmware.home(x, speed=make_speeds(x, 5, 0.07))
    waveform = report.waveforms
    org, time = waveform.edges["inputs"] & x.chip.find_switch_input("org") != 0, waveform.seconds
    first = int(org.argmax())
    in_bounce = (time[:-1] >= time[first]) & (time[:-1] < time[first] + 1.5 * BOUNCE_S)
    off = (time[1:] - time[:-1])[in_bounce & ~org[:-1]]
    return {
        "edges of ORG that the chip saw": int((org[1:] != org[:-1]).sum()),
        "after the first edge ORG is off for, ms": float(off.sum()) * 1e3,
        "origin return stopped by": report.stopped_by,
        "origin, um": x.position * 1e6,
    }


def home_without_vane(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Home while ORG's vane is missing."""
    x = get_first_axis(stage)
    with make_fault(faults.vane_missing, x, "org"):
        report = firmware.home(x, speed=make_speeds(x, 5, 0.07))
        return {
            "stopped by": report.stopped_by,
            "pulses made": report.pulses,
            "past ORG, mm": (find_switch_position(x, "org") - x.position) * 1e3,
            "lost steps": report.lost_steps,
        }


def move_with_heavy_payload(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Make a move with a payload of twice the planned mass."""
    x = get_first_axis(stage)
    stage.set_payload(10.0)
    with make_fault(faults.payload, stage, 2.0):
        return {"payload, kg": stage.payload()} | start_move(x, 10, 18.75, 0.046)()


def move_with_falling_supply(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Make a move during which the supply falls to 8 V."""
    x = get_first_axis(stage)
    finish = start_move(x, 12.5, 18.75, 0.1, 0.46875)
    x.wait(0.3)
    with make_fault(faults.bus_voltage, x, 8.0):
        return finish()


def move_with_jam(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Make a move during which the axis jams."""
    x = get_first_axis(stage)
    finish = start_move(x, 10, 6.25, 0.1)
    x.wait(0.5)
    place = x.position
    with make_fault(faults.jam, x):
        return finish() | {"on from 0.5 s, mm": (x.position - place) * 1e3}


def move_with_open_phase(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Open phase B of the motor before a move from rest, and during a move."""
    x = get_first_axis(stage)
    with make_fault(faults.phase_open, x, "b"):
        figures = start_move(x, 5, 3.125, 0.1)()
    stage.place(**{x.name: -0.05})
    finish = start_move(x, 7.5, 6.25, 0.1)
    x.wait(0.5)
    with make_fault(faults.phase_open, x, "b"):
        return figures | {"opened at 6.25 turns/s: lost steps": finish().get("lost steps")}  # a servo: refused


def move_line_with_start_skew(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Draw a line whose two start commands are 5 ms apart."""
    last = get_first_axis(stage)
    other = _find_axis_started_separately(stage, last)
    # the longest one last: it is started last
    distances = {
        other: convert_revolutions_to_pulses(other, -2.34375), last: convert_revolutions_to_pulses(last, 6.25),
    }  # fmt: skip
    with make_fault(faults.start_skew, last, 5e-3):
        report = firmware.line(distances, pulses=True, speed=make_speeds(last, 6.25, 0.15))
    return {
        "done": "yes" if report.ok else "no",
        "started within, ms": report.skew * 1e3,
        "off the line, pulses": float(report.deviation.pulses),
        "carriages off the line, um": (report.carriage_deviation or 0.0) * 1e6,
        "finished within, ms": report.finish * 1e3,
    }


def _find_axis_started_separately(stage: Any, axis: Any) -> Any:
    """Return an axis that a line with `axis` starts by a separate command. Raises StageError, with the reason, if there is none."""
    chip = axis.chip.MAP.chip
    if get_driver(axis).has_position_loop:
        raise StageError(
            f"start-skew: no command starts the axes of a line with {chip}s: the host leads each by command positions, sample by "
            "sample. Show it with chips that make pulses."
        )
    others = [other for other in stage.axes.values() if other is not axis]
    if not others:
        raise StageError("start-skew: a line is of two axes, and the model has one. Choose another, for example xyz.")
    for other in others:
        if other.chip is not axis.chip:
            return other
    raise StageError(
        f"start-skew: one command starts all axes of a line, which are one {chip}'s: nothing comes between. Show it with "
        "a chip for each axis, as the PCL-240 is."
    )


def move_with_lost_write(stage: Any, make_fault: MakeFault) -> MeasuredValues:
    """Make a move whose write of the distance gets lost on the bus."""
    x = get_first_axis(stage)
    turns = min(5, 0.9 * (x.travel[1] - x.position) * abs(x.gear) / (2 * math.pi))
    distance, register = convert_revolutions_to_pulses(x, turns), get_driver(x).DISTANCE_REGISTER
    written, nothing = (x.chip.register_cycles(register, value, x.chip_axis) for value in (distance, 0))
    address, value = next(cycle for cycle, other in zip(written, nothing, strict=True) if cycle != other)
    with make_fault(faults.lost_write, x, address, value):
        return {"asked": distance} | start_move(x, turns, 3.125, 0.1)() | {"diagnostics": len(x.chip.diagnostics)}
