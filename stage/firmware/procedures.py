"""Moves with every chip, in physical units: move, home, line, jog, stop. Each uses the driver of the chip's family.

    firmware.move(x, 10e-3)                               10 mm; on a hinge rad
    firmware.move(x, pulses=3200, speed=0.05)             50 mm/s
    firmware.line({"x": 20e-3, "y": -7.5e-3}, stage.axes)

What only one family can do has functions of its own: `preset_move` and the others of the PCL-240, firmware.nova, firmware.hctl1100.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from stage.chips.exclusive_access import exclusive
from stage.errors import ArgumentError, add_article
from stage.firmware.axis import AxesByName, Axis, check_direction, check_seconds, get_forward_direction
from stage.firmware.driver import DEFAULT_RAMP_S, DUAL_RATE_ORDER, Driver, Speeds, get_default_speeds, get_driver
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.synchronized_report import SynchronizedReport, select_axes
from stage.support.argument_checks import check_timeout, explain_arguments


@explain_arguments
def move(
    axis: Axis,
    distance: float | None = None,
    *,
    pulses: int | None = None,
    speed: float | Speeds | None = None,
    start_speed: float | None = None,
    accel: float = DEFAULT_RAMP_S,
    decel: float | None = None,
    s_curve: bool = False,
    timeout: float | None = None,
) -> Report:
    """Move an axis by a distance, and wait until it is there.

    Args:
        axis: Axis of a Stage or a Bench.
        distance: Signed distance, m (rad on a hinge); the nearest whole pulse is made.
        pulses: Signed pulses in place of a distance; counts of a servo.
        speed: Drive speed, m/s (rad/s); default: 16,000 pulses per second, of 1/16 full step where the chip itself determines the
            microsteps. Or `Speeds`, which state everything about rates and ramps.
        start_speed: Start speed, m/s (rad/s); default: 1,000 pulses per second. A servo has none.
        accel: Time of the ramp up, s.
        decel: Time of the ramp down, s; default: `accel`.
        s_curve: Ramps without corners.
        timeout: Simulated seconds to wait; default: half as much again as the move can take, and one.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: The chip cannot do it; the message says why.
        StageError: The axis moves already.
        RunTimeout: The axis still moved after `timeout`.
    """
    check_timeout(timeout)
    options = {"speed": speed, "start_speed": start_speed, "accel": accel, "decel": decel, "s_curve": s_curve}
    return get_driver(axis).move(convert_to_pulses(axis, distance, pulses), parse_speeds(axis, options), timeout)


@explain_arguments
def move_at_two_rates(
    axis: Axis,
    distance: float | None = None,
    *,
    speed: Speeds,
    pulses: int | None = None,
    dwell: float = 0.1,
    rates: Sequence[str] = DUAL_RATE_ORDER,
) -> Report:
    """Move an axis through several drive speeds, and wait until it is there. A chip with one drive speed moves at `speed.second`.

    Args:
        axis, distance, pulses: As of `move`.
        speed: Speeds, of which `second` is the second drive speed.
        dwell: Seconds at each speed but the last, after its ramp.
        rates: "FL", "FH1" and "FH2" in the order of the move: start, first and second drive speed.

    Raises:
        ArgumentError, StageError, RunTimeout: As `move`.
    """
    return get_driver(axis).two_rates(convert_to_pulses(axis, distance, pulses), speed, dwell, rates)


@explain_arguments
def home(
    axis: Axis,
    direction: int = -1,
    *,
    index: int = 0,
    speed: float | Speeds | None = None,
    start_speed: float | None = None,
    accel: float = DEFAULT_RAMP_S,
    timeout: float = 60.0,
    by: str | None = None,
) -> Report:
    """Return to the mechanical origin ORG, which lies in `direction`, from any position.

    Args:
        axis: Axis of a Stage or a Bench.
        direction: Direction in which ORG lies, 1 or -1.
        index: Number of the index pulse of the encoder after ORG at which the return ends, True or 1 for the first; not every chip
            counts more.
        speed: Drive speed, m/s (rad/s), or `Speeds`, as of `move`.
        start_speed: Start speed, m/s (rad/s).
        accel: Time of the ramps, s.
        timeout: Simulated seconds to wait.
        by: "switch"; "index", which is index=True; for other chips one of their driver's HOMINGS, for example "stall". Default: the
            switch, or as `index` says.

    Returns:
        A report whose `stopped_by` is "ORG", or "EZ", or what was met in its place.

    Raises:
        ArgumentError: The chip cannot do it.
        StageError: The axis moves already.
        RunTimeout: The return took longer than `timeout`.
    """
    check_direction(direction)
    check_timeout(timeout)
    driver = get_driver(axis)
    wanted = parse_speeds(axis, {"speed": speed, "start_speed": start_speed, "accel": accel})
    if by is not None:
        driver.check_homing(by, index)
    if by not in (None, "switch", "index"):
        return driver.home_by(by, direction, wanted, timeout)
    driver.check_origin()
    index = int(index) or int(by == "index")
    if not 0 <= index <= driver.INDEX_PULSES:
        most = f" to {driver.INDEX_PULSES}" if driver.INDEX_PULSES > 1 else ""
        raise ArgumentError(
            f"index={index}: {add_article(driver.chip.MAP.chip)} ends at ORG, index=0, or at index pulse 1{most} after it."
        )
    return driver.home(direction, wanted, index, timeout)


@explain_arguments
@exclusive
def jog(
    axis: Axis,
    seconds: float,
    speed: float | None = None,
    *,
    start_speed: float | None = None,
    accel: float = DEFAULT_RAMP_S,
) -> Report:
    """Run for some time, then stop with a ramp.

    Args:
        axis: Axis of a Stage or a Bench.
        seconds: Simulated time of the run, s.
        speed: Signed speed of the carriage, m/s (rad/s); default: 16,000 pulses per second in the plus direction.
        start_speed: Start speed, m/s (rad/s).
        accel: Time of the ramps, s.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: The chip cannot do it.
        StageError: The axis moves already.
    """
    check_seconds(seconds)
    driver, direction = get_driver(axis), get_forward_direction(axis)
    if speed is not None and speed < 0:
        direction = -direction
    options = {"speed": None if speed is None else abs(speed), "start_speed": start_speed, "accel": accel}
    wanted = parse_speeds(axis, options)
    driver.prepare()
    with ProcedureObserver(axis, "jog") as p:
        driver.run(direction, wanted)
        axis.wait(seconds)
        met = "" if driver.is_running() else driver.explain_end(False, p.journal)
        driver.halt()
        return p.report(met or "decelerating stop")


@explain_arguments
def stop(axis: Axis, at_once: bool = False) -> None:
    """Stop the axis, with a ramp or at once, and wait until it is at rest."""
    get_driver(axis).halt(at_once)


@explain_arguments
@exclusive
def line(
    distances: Mapping[str, float] | Mapping[Axis, float],
    axes: AxesByName = None,
    *,
    pulses: bool = False,
    speed: float | Speeds | None = None,
    start_speed: float | None = None,
    accel: float = DEFAULT_RAMP_S,
    s_curve: bool = False,
    timeout: float | None = None,
) -> SynchronizedReport:
    """Move several axes along a straight line.

    The PCL-240 draws it by registers in the ratio of the distances, a NOVA chip by its interpolation where it has one, else by
    ranges in that ratio, an HCTL-1100 by command positions in each sample. When an end limit, or anything else, stops one axis
    early, the others are
    slowed down and stopped: the line is lost.

    Args:
        distances: Axis name (or axis) -> signed distance, m. 0 keeps an axis still, and the report leaves it out; one axis that
            moves is enough.
        axes: Stage, bench, or mapping such as stage.axes in which the names are found. Not needed when the keys are axes.
        pulses: Distances are pulses; counts of servos.
        speed: Drive speed of the axis with the most pulses, m/s, or `Speeds`.
        start_speed: Start speed of that axis, m/s.
        accel: Time of its ramps, s.
        s_curve: Ramps without corners.
        timeout: Simulated seconds to wait; default: half as much again as the line can take, and one.

    Returns:
        A report of all axes.

    Raises:
        ArgumentError: The chips cannot do it, with the reason, or every distance is 0.
        RunTimeout: An axis still moved after `timeout`.
    """
    check_timeout(timeout)
    selected = select_axes(distances, axes, "line")
    drivers = {name: get_driver(axis) for name, (axis, _) in selected.items()}
    if not drivers:
        raise ArgumentError("no distances: give at least one axis a distance.")
    check_same_chip_kind(drivers)
    counts = {
        name: convert_to_pulses(axis, None, d) if pulses else convert_to_pulses(axis, d, None)
        for name, (axis, d) in selected.items()
    }
    main_axis = selected[max(counts, key=lambda n: abs(counts[n]))][0]
    first = next(iter(drivers.values()))
    options = {"speed": speed, "start_speed": start_speed, "accel": accel, "s_curve": s_curve}
    return first.line(drivers, counts, parse_speeds(main_axis, options), timeout)


def check_same_chip_kind(drivers: Mapping[str, Driver]) -> None:
    """Raise ArgumentError where the chips of a line's axes are of several kinds."""
    kinds = sorted({type(d).__name__: d.chip.MAP.chip for d in drivers.values()}.values())
    if len(kinds) > 1:
        raise ArgumentError(f"{' and '.join(kinds)} draw no line together: give the axes one kind of chip.")


OPTION_FIELDS = {"start_speed": "start", "speed": "drive", "second": "second", "accel": "up", "decel": "down"}
"""Options of users, and the fields of `Speeds` that they give."""
SAME_NAME_OPTIONS = ("s_curve", "constant", "automatic", "approach")
"""Fields of `Speeds` that are options under their own names."""


def parse_speeds(axis: Axis, options: Mapping[str, Any], in_pulses: bool = False) -> Speeds:
    """Return the speeds that a user's options ask of an axis; every face of the product turns options into `Speeds` here.

    Args:
        axis: Axis that moves.
        options: By name: `speed`, `start_speed` and `second` in m/s (rad/s on a hinge), `accel` and `decel` in s, `s_curve`,
            `constant`, `automatic` and `approach` as fields of `Speeds`. Usual values stand for None and for what is missing,
            decel as accel. A `speed` that is `Speeds` says everything. Other names are ignored.
        in_pulses: Speeds are in pulses (counts) per second.

    Raises:
        ArgumentError: A speed or a time is not greater than 0, or the chip does not have what an option asks for.
    """
    made = options.get("speed")
    if not isinstance(made, Speeds):
        given = {name: options[name] for name in (*OPTION_FIELDS, *SAME_NAME_OPTIONS) if options.get(name) is not None}
        for name in (name for name in OPTION_FIELDS if name in given):
            if not 0 < given[name] < math.inf:
                raise ArgumentError(f"{name}={given[name]!r}: must be greater than 0, and finite.")
            if not in_pulses and name not in ("accel", "decel"):
                given[name] /= _get_meters_per_pulse(axis, name)
        given.setdefault("decel", given.get("accel", DEFAULT_RAMP_S))
        made = get_default_speeds(axis.chip)._replace(
            **{OPTION_FIELDS.get(name, name): value for name, value in given.items()}
        )
        if "start_speed" not in given:
            made = made._replace(start=min(made.start, made.drive, made.second or math.inf))
    get_driver(axis).check_speeds(made)
    return made


def convert_to_pulses(axis: Axis, distance: float | None, pulses: int | None) -> int:
    """Return the signed pulses, as the chip counts, of a distance or of pulses.

    Args:
        axis: Axis that moves.
        distance: Signed distance of the carriage, m (rad on a hinge), or None.
        pulses: Signed pulses, or None.

    Raises:
        ArgumentError: Both or neither are given, or no whole number.
    """
    if (distance is None) == (pulses is None):
        raise ArgumentError(f"distance={distance!r}, pulses={pulses!r}: give one of the two.")
    if pulses is not None:
        if not math.isfinite(pulses) or int(pulses) != pulses:
            raise ArgumentError(f"pulses={pulses!r}: a whole number; the sign is the direction.")
        return int(pulses)
    if not isinstance(distance, int | float) or not math.isfinite(distance):
        raise ArgumentError(f"distance={distance!r}: metres, or radians on a hinge.")
    return round(get_forward_direction(axis) * distance / _get_meters_per_pulse(axis, "distance"))


def _get_meters_per_pulse(axis: Axis, what: str) -> float:
    """Return the distance of a pulse, m. Raises ArgumentError for an axis without a carriage."""
    if axis.meters_per_pulse is None:
        raise ArgumentError(f"{what}: axis {axis.name} has no carriage and no metres: give pulses=, and no speed.")
    return axis.meters_per_pulse
