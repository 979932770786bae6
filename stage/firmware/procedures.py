"""Moves with every chip, in physical units: move, home, line, jog, stop. Each uses the driver of the chip's family.

    firmware.move(x, 10e-3)                               10 mm; on a hinge rad
    firmware.move(x, pulses=3200, speed=0.05)             50 mm/s
    firmware.line({"x": 20e-3, "y": -7.5e-3}, stage.axes)

What only one family can do has functions of its own: `preset_move` and the others of the PCL-240, firmware.nova, firmware.hctl1100.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from stage.chips.sharing import exclusive
from stage.errors import ArgumentError
from stage.firmware.axis import Axes, Axis, forward
from stage.firmware.driver import RAMP, Driver, Speeds, driver_of, usual_speeds
from stage.firmware.report import Procedure, Report
from stage.firmware.together import SynchronizedReport, chosen_axes
from stage.support.arguments import patience, told


@told
def move(
    axis: Axis,
    distance: float | None = None,
    *,
    pulses: int | None = None,
    speed: float | None = None,
    start_speed: float | None = None,
    accel: float = RAMP,
    decel: float | None = None,
    s_curve: bool = False,
    timeout: float | None = None,
) -> Report:
    """Move an axis by a distance, and wait until it is there.

    Args:
        axis: of a Stage or a Bench.
        distance: m (rad on a hinge), signed; the nearest whole pulse is made. Or pulses: so many, signed; of a servo counts.
        speed, start_speed: m/s (rad/s); default 16,000 and 1,000 pulses a second, of 1/16 full step where the chip itself says what
            a pulse is. A servo has no start speed.
        accel, decel: s, of the ramps between them; decel defaults to accel.
        s_curve: ramps without corners. timeout: s; default half as much again as the move can take, and one.
    Raises ArgumentError for what the chip cannot do, in words; StageError for an axis that moves already; RunTimeout.
    """
    patience(timeout)
    driver = driver_of(axis)
    return driver.move(
        pulses_of(axis, distance, pulses), speeds(axis, speed, start_speed, accel, decel, s_curve), timeout
    )


@told
def home(
    axis: Axis,
    direction: int = -1,
    *,
    index: bool = False,
    speed: float | None = None,
    start_speed: float | None = None,
    accel: float = RAMP,
    timeout: float = 60.0,
    by: str | None = None,
) -> Report:
    """Return to the mechanical origin ORG, which lies in `direction`, from any place; `index`: and on to the encoder's index pulse.

    by: "switch"; "index", which is index=True; of other chips what their driver says in HOMINGS, for example "stall". Default:
    the switch, or as `index` says.

    The report's `stopped_by` is "ORG", or "EZ", or what was met in its place. The other arguments are those of `move`. Raises
    ArgumentError, StageError, RunTimeout.
    """
    if direction not in (1, -1):
        raise ArgumentError(f"direction={direction!r}: +1 or -1.")
    patience(timeout)
    driver, wanted = driver_of(axis), speeds(axis, speed, start_speed, accel, None, False)
    if by in (None, "switch", "index"):
        driver.check_origin()
    if by is None:
        return driver.home(direction, wanted, index, timeout)
    driver.check_homing(by, index)
    return driver.home_by(by, direction, wanted, timeout)


@told
@exclusive
def jog(
    axis: Axis, seconds: float, speed: float | None = None, *, start_speed: float | None = None, accel: float = RAMP
) -> Report:
    """Run for `seconds`, then stop with a ramp. speed: m/s (rad/s), the sign is the carriage's direction; default 16,000 pulses a
    second, plus. Raises ArgumentError, StageError."""
    if not 0 <= seconds < 1e9:
        raise ArgumentError(f"seconds={seconds!r}: time runs forward, by 0 to 1e9 s.")
    driver, direction = driver_of(axis), -forward(axis) if speed is not None and speed < 0 else forward(axis)
    wanted = speeds(axis, None if speed is None else abs(speed), start_speed, accel, None, False)
    driver.ready()
    with Procedure(axis, "jog") as p:
        driver.run(direction, wanted)
        axis.wait(seconds)
        met = "" if driver.runs() else driver.explain_end(False, p.journal)
        driver.halt()
        return p.report(met or "decelerating stop")


@told
def stop(axis: Axis, at_once: bool = False) -> None:
    """Stop the axis, with a ramp or at once, and wait until it is at rest."""
    driver_of(axis).halt(at_once)


@told
@exclusive
def line(
    distances: Mapping[str, float] | Mapping[Axis, float],
    axes: Axes = None,
    *,
    pulses: bool = False,
    speed: float | None = None,
    start_speed: float | None = None,
    accel: float = RAMP,
    s_curve: bool = False,
    timeout: float | None = None,
) -> SynchronizedReport:
    """Move several axes along a straight line.

    Args:
        distances: axis name (or axis) -> m, signed; with `pulses` pulses, of servos counts. 0 keeps an axis still, and the
            report leaves it out; one axis that moves is enough.
        axes: where the names are: a stage, a bench, or a mapping such as stage.axes. Not needed when the keys are axes.
        speed, start_speed: m/s, of the axis with the most pulses. accel: s of its ramps.
    The PCL-240 draws it by registers in the ratio of the distances, a NOVA chip by its interpolation where it has one, else by
    ranges in that ratio, an HCTL-1100 by command positions in each sample. When an end limit, or anything else, stops one axis
    early, the others are slowed down and stopped: the line is lost. Raises ArgumentError where the chips cannot, with the
    reason, and where every distance is 0; RunTimeout.
    """
    patience(timeout)
    chosen = chosen_axes(distances, axes, "line")
    drivers = {name: driver_of(axis) for name, (axis, _) in chosen.items()}
    if not drivers:
        raise ArgumentError("no distances: give at least one axis a distance.")
    check_one_kind(drivers)
    counts = {
        name: pulses_of(axis, None, d) if pulses else pulses_of(axis, d, None) for name, (axis, d) in chosen.items()
    }
    longest = chosen[max(counts, key=lambda n: abs(counts[n]))][0]
    first = next(iter(drivers.values()))
    return first.line(drivers, counts, speeds(longest, speed, start_speed, accel, None, s_curve), timeout)


def check_one_kind(drivers: Mapping[str, Driver]) -> None:
    """Raise ArgumentError where the chips of a line's axes are of several kinds."""
    kinds = sorted({type(d).__name__: d.chip.MAP.chip for d in drivers.values()}.values())
    if len(kinds) > 1:
        raise ArgumentError(f"{' and '.join(kinds)} draw no line together: give the axes one kind of chip.")


def speeds(
    axis: Axis, speed: float | None, start_speed: float | None, accel: float, decel: float | None, s_curve: bool
) -> Speeds:
    """Speeds of an axis from physical units. Raises ArgumentError."""
    for name, value in (("speed", speed), ("start_speed", start_speed), ("accel", accel), ("decel", decel)):
        if value is not None and not 0 < value < math.inf:
            raise ArgumentError(f"{name}={value!r}: more than 0.")
    usual = usual_speeds(axis.chip)
    drive = usual.drive if speed is None else speed / _unit(axis, "speed")
    start = min(usual.start, drive) if start_speed is None else start_speed / _unit(axis, "start_speed")
    return Speeds(start, drive, accel, accel if decel is None else decel, s_curve)


def pulses_of(axis: Axis, distance: float | None, pulses: int | None) -> int:
    """Pulses, the sign as the chip counts. Raises ArgumentError."""
    if (distance is None) == (pulses is None):
        raise ArgumentError(f"distance={distance!r}, pulses={pulses!r}: give one of the two.")
    if pulses is not None:
        if not math.isfinite(pulses) or int(pulses) != pulses:
            raise ArgumentError(f"pulses={pulses!r}: a whole number; the sign is the direction.")
        return int(pulses)
    if not isinstance(distance, int | float) or not math.isfinite(distance):
        raise ArgumentError(f"distance={distance!r}: metres, or radians on a hinge.")
    return round(forward(axis) * distance / _unit(axis, "distance"))


def _unit(axis: Axis, what: str) -> float:
    if axis.meters_per_pulse is None:
        raise ArgumentError(f"{what}: axis {axis.name} has no carriage and no metres: give pulses=, and no speed.")
    return axis.meters_per_pulse
