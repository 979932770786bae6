"""Procedures for every chip, in physical units: move, home, line, jog, stop. Each uses the driver of the chip's family.

    firmware.move(x, 10e-3)                               10 mm; on a hinge rad
    firmware.move(x, pulses=3200, speed=0.05)             50 mm/s
    firmware.line({"x": 20e-3, "y": -7.5e-3}, stage.axes)
    action = firmware.begin_move(x, 10e-3)                returns at once; the move goes on while time passes

begin_move, begin_home, begin_jog and begin_stop take the arguments of the blocking procedures, see axis_actions.py.

Procedures that only one family offers are separate functions: `preset_move` and others of the PCL-240, `firmware.nova` and
`firmware.hctl1100`.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from stage.chips.exclusive_access import exclusive
from stage.errors import ArgumentError, add_article
from stage.firmware.axis import AxesByName, Axis, check_direction, check_seconds, get_forward_direction
from stage.firmware.axis_actions import AxisAction, begin_action, cancel_action, check_no_action
from stage.firmware.driver import (
    DEFAULT_RAMP_S,
    DUAL_RATE_ORDER,
    MAX_POLL_S,
    Driver,
    Speeds,
    get_default_speeds,
    get_driver,
)
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.synchronized_report import SynchronizedReport, select_axes
from stage.support.argument_checks import check_timeout, explain_arguments
from stage.units import OTHER_FACTORS, POSITION_FACTORS, POSITION_UNITS


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
        distance: Signed distance, m (rad on a hinge), which is rounded to whole pulses. A distance beyond the end limits causes a
            warning, and the limit switch ends the move.
        pulses: Signed pulses instead of a distance; counts of a servo.
        speed: Drive speed, m/s (rad/s), or `Speeds` with all rates and ramps. Default: 16,000 pulses per second; if the chip itself
            determines the microsteps, the speed of 16,000 pulses of 1/16 full step per second.
        start_speed: Start speed, m/s (rad/s); default: 1,000 pulses per second. A servo has none.
        accel: Time of the ramp up, s.
        decel: Time of the ramp down, s; default: `accel`.
        s_curve: True for S-curve ramps.
        timeout: Simulated seconds to wait; default: 1.5 times the longest possible duration plus one second.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: The chip cannot do it; the message says why.
        StageError: The axis moves already.
        RunTimeout: The axis still moved after `timeout`.
    """
    check_no_action(axis)
    check_timeout(timeout)
    options = {"speed": speed, "start_speed": start_speed, "accel": accel, "decel": decel, "s_curve": s_curve}
    count, speeds = convert_to_pulses(axis, distance, pulses), parse_speeds(axis, options)
    if distance is not None and (text := describe_overtravel(axis, count)):
        warnings.warn(f"distance={distance:g}: {text}", stacklevel=3)
    with explain_rates_in_units(axis, "SI" if isinstance(speed, int | float) else ""):
        return get_driver(axis).move(count, speeds, timeout)


@explain_arguments
@exclusive
def begin_move(axis: Axis, distance: float | None = None, **options: Any) -> AxisAction:
    """Begin a move, and do not wait for its end.

    Args:
        axis: Axis of a Stage or a Bench.
        distance: Signed distance, m (rad on a hinge).
        **options: Keyword arguments of `move`.

    Returns:
        The action, whose `report` is that of `move`.

    Raises:
        ArgumentError: The chip cannot do it; nothing has moved.
        StageError: The axis moves already, or has an action under way.
    """
    return begin_action(axis, "move", lambda: move(axis, distance, **options))


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
        axis: Axis to move, with any chip.
        distance: Signed distance, m or rad. Give this or `pulses`.
        pulses: Signed number of pulses, or encoder counts of a servo.
        speed: Speeds, of which `second` is the second drive speed.
        dwell: Seconds at each speed except the last one, after its ramp.
        rates: "FL", "FH1" and "FH2" in the order of the move: start, first and second drive speed.

    Raises:
        ArgumentError, StageError, RunTimeout: Same as for `move`.
    """
    return get_driver(axis).move_at_two_rates(convert_to_pulses(axis, distance, pulses), speed, dwell, rates)


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
        index: Number of the encoder's index pulse after ORG at which the return ends; True or 1 for the first. Not every chip
            can count more than one.
        speed: Drive speed, m/s (rad/s), or `Speeds`, same as for `move`.
        start_speed: Start speed, m/s (rad/s).
        accel: Time of the ramps, s.
        timeout: Simulated seconds to wait.
        by: Homing method: "switch", "index" (equal to index=True), or another method of the chip's driver (HOMING_METHODS), for
            example "stall". Default: the switch, and the index pulse if `index` requests it.

    Returns:
        A report whose `stopped_by` is "ORG" or "EZ" after success, and otherwise names what stopped the axis.

    Raises:
        ArgumentError: The chip cannot do it.
        StageError: The axis moves already.
        RunTimeout: The return took longer than `timeout`.
    """
    check_no_action(axis)
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
        pulses = (
            f", or at index pulse 1{most} after it" if driver.INDEX_PULSES else "; it has no input for index pulses"
        )
        raise ArgumentError(f"index={index}: {add_article(driver.chip.MAP.chip)} ends at ORG, index=0{pulses}.")
    return driver.home(direction, wanted, index, timeout)


@explain_arguments
@exclusive
def begin_home(axis: Axis, direction: int = -1, **options: Any) -> AxisAction:
    """Begin a return to the mechanical origin, and do not wait for its end.

    Args:
        axis: Axis of a Stage or a Bench.
        direction: Direction in which ORG lies, 1 or -1.
        **options: Keyword arguments of `home`.

    Returns:
        The action, whose `report` is that of `home`.

    Raises:
        ArgumentError: The chip cannot do it; nothing has moved.
        StageError: The axis moves already, or has an action under way.
    """
    return begin_action(axis, "home", lambda: home(axis, direction, **options))


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
    """Move an axis for some time, then stop it with a ramp.

    Args:
        axis: Axis of a Stage or a Bench.
        seconds: Simulated time until the stop command, s.
        speed: Signed speed of the carriage, m/s (rad/s); default: 16,000 pulses per second in the plus direction.
        start_speed: Start speed, m/s (rad/s).
        accel: Time of the ramps, s.

    Returns:
        What the host could observe, and the true state of the stage beside it.

    Raises:
        ArgumentError: The chip cannot do it.
        StageError: The axis moves already.
    """
    check_no_action(axis)
    check_seconds(seconds)
    return _jog(axis, speed, start_speed, accel, lambda driver: axis.wait(seconds))


@explain_arguments
@exclusive
def begin_jog(
    axis: Axis, speed: float | None = None, *, start_speed: float | None = None, accel: float = DEFAULT_RAMP_S
) -> AxisAction:
    """Begin a move without an end, which `begin_stop`, `stop` or a limit switch ends.

    Args:
        axis: Axis of a Stage or a Bench.
        speed: Signed speed of the carriage, as that of `jog`.
        start_speed: Start speed, m/s (rad/s).
        accel: Time of the ramps, s.

    Returns:
        The action. Its `report` says which switch has ended the move; a stop cancels the action.

    Raises:
        ArgumentError: The chip cannot do it; nothing has moved.
        StageError: The axis moves already, or has an action under way.
    """

    def wait_for_end(driver: Driver) -> None:
        """Wait until something, such as a limit switch, stops the axis of this driver."""
        while driver.is_running():
            axis.wait(MAX_POLL_S)

    return begin_action(axis, "jog", lambda: _jog(axis, speed, start_speed, accel, wait_for_end))


def _jog(
    axis: Axis, speed: float | None, start_speed: float | None, accel: float, wait: Callable[[Driver], None]
) -> Report:
    """Start a continuous move, call `wait`, then stop the axis with a ramp; the other arguments are those of `jog`."""
    driver, direction = get_driver(axis), get_forward_direction(axis)
    if speed is not None and speed < 0:
        direction = -direction
    options = {"speed": None if speed is None else abs(speed), "start_speed": start_speed, "accel": accel}
    wanted = parse_speeds(axis, options)
    driver.prepare()
    with ProcedureObserver(axis, "jog") as p:
        driver.start_continuous_move(direction, wanted)
        wait(driver)
        met = "" if driver.is_running() else driver.explain_end(False, p.journal)
        driver.halt()
        return p.make_report(met or "decelerating stop")


@explain_arguments
def stop(axis: Axis, at_once: bool = False) -> None:
    """Stop the axis, with a ramp or at once, and wait until it is at rest. An action of the axis is cancelled."""
    cancel_action(axis)
    get_driver(axis).halt(at_once)


@explain_arguments
@exclusive
def begin_stop(axis: Axis, at_once: bool = False) -> AxisAction:
    """Begin to stop the axis, with a ramp or at once, and do not wait until it is at rest. An action of the axis is cancelled.

    Args:
        axis: Axis of a Stage or a Bench.
        at_once: Whether the axis stops without a ramp.

    Returns:
        The action, which is done when the axis is at rest. It has no report.
    """
    cancel_action(axis)
    return begin_action(axis, "stop", lambda: stop(axis, at_once))


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

    PCL-240 chips use registers in the ratio of the distances. A NOVA chip interpolates, or uses ranges in that ratio if it has no
    interpolation. HCTL-1100 chips get a command position in each sample. If an end limit or another cause stops one axis early, the
    others slow down and stop.

    Args:
        distances: Axis name (or axis) -> signed distance, m. At least one must not be 0; the report leaves out axes with 0.
        axes: Stage, bench, or mapping such as stage.axes that contains the names. Not needed if the keys are axes.
        pulses: True if the distances are pulses; counts of servos.
        speed: Drive speed of the axis with the most pulses, m/s, or `Speeds`.
        start_speed: Start speed of that axis, m/s.
        accel: Time of its ramps, s.
        s_curve: True for S-curve ramps.
        timeout: Simulated seconds to wait; default: 1.5 times the longest possible duration plus one second.

    Returns:
        A report of all axes.

    Raises:
        ArgumentError: The chips cannot make this line (the message says why), or every distance is 0.
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
    return first.move_line(drivers, counts, parse_speeds(main_axis, options), timeout)


def check_same_chip_kind(drivers: Mapping[str, Driver]) -> None:
    """Raise ArgumentError if the chips of a line's axes are of different kinds."""
    kinds = sorted({type(d).__name__: d.chip.MAP.chip for d in drivers.values()}.values())
    if len(kinds) > 1:
        raise ArgumentError(f"{' and '.join(kinds)} draw no line together: give the axes one kind of chip.")


OPTION_FIELDS = {"start_speed": "start", "speed": "drive", "second": "second", "accel": "up", "decel": "down"}
"""Option of a user -> field of `Speeds` that it sets."""
SAME_NAME_OPTIONS = ("s_curve", "constant", "automatic", "approach")
"""Fields of `Speeds` whose options have the same names."""


def parse_speeds(axis: Axis, options: Mapping[str, Any], in_pulses: bool = False) -> Speeds:
    """Convert the options of a user to `Speeds` for an axis. The command line, the panel and the agents' tools use it.

    Args:
        axis: Axis that moves.
        options: `speed`, `start_speed` and `second` in m/s (rad/s on a hinge), `accel` and `decel` in s; `s_curve`, `constant`,
            `automatic` and `approach` have the meaning of the fields of `Speeds`. Missing options and None get the usual values;
            `decel` gets the value of `accel`. A `speed` that is `Speeds` overrides all others. Other names are ignored.
        in_pulses: True if speeds are in pulses (counts) per second.

    Raises:
        ArgumentError: A speed or a time is not greater than 0, or the chip does not support an option.
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
    with explain_rates_in_units(axis, "SI" if isinstance(options.get("speed"), int | float) and not in_pulses else ""):
        get_driver(axis).check_speeds(made)
    return made


@contextmanager
def explain_rates_in_units(axis: Any, symbol: str) -> Iterator[None]:
    """Within this block, add to each pulse rate in the text of an ArgumentError the speed of the carriage.

    Args:
        axis: Axis that moves.
        symbol: Unit in which the user has given a speed, for example "mm/s"; "SI" for m/s or rad/s; "" for pulses per second:
            then errors stay as they are.
    """
    try:
        yield
    except ArgumentError as error:
        if symbol and axis.meters_per_pulse is not None:
            error.args = (_add_speeds(str(error), axis, symbol), *error.args[1:])
        raise


def _add_speeds(text: str, axis: Any, symbol: str) -> str:
    """Return a text with the speed of the carriage after each pulse rate, for example 4000 pps (12.5 mm/s)."""
    symbol = f"{axis.unit}/s" if symbol == "SI" else symbol
    distance, second = symbol.split("/")
    unit = POSITION_FACTORS[axis.unit][distance] / OTHER_FACTORS["time"][second]

    def add(match: re.Match) -> str:
        rates = [float(number.replace(",", "")) for number in (match[1], match[2]) if number]
        speeds = " to ".join(f"{rate * axis.meters_per_pulse / unit:.4g}" for rate in rates)
        return f"{match[0]} ({speeds} {symbol})"

    number = r"(\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?)"
    return re.sub(rf"{number}(?: to {number})? (?:pps|counts/s|steps per second)", add, text)


def find_travel_range(axis: Any) -> tuple[float, float]:
    """Return the positions of an axis of a stage between its end limits, m or rad; without limits the ends of its travel."""
    ends = {s.pin: s.touch for s in axis.plant.switches}
    low, high = (-math.inf, math.inf) if axis.unit == "rad" else axis.travel  # a hinge without limits turns without end
    return ends.get("el_minus", low), ends.get("el_plus", high)


def describe_overtravel(axis: Any, pulses: int) -> str:
    """Describe a move past an end limit of the axis, or past the end of its travel if it has no limits; "" for any other move.

    Args:
        axis: Axis that is about to move; an axis of a bench has no travel.
        pulses: Signed pulses of the move.
    """
    if getattr(axis, "plant", None) is None or axis.meters_per_pulse is None:
        return ""
    low, high = find_travel_range(axis)
    goal = axis.position + pulses * axis.meters_per_pulse * get_forward_direction(axis)
    slack = abs(axis.meters_per_pulse)
    if low - slack <= goal <= high + slack:
        return ""
    unit = POSITION_UNITS[axis.unit]
    return (
        f"axis {axis.name} reaches from {low * unit.factor:g} to {unit.format(high, 'g')}, and this move goes to "
        f"{unit.format(goal, '.4g')}."
    )


def convert_to_pulses(axis: Axis, distance: float | None, pulses: int | None) -> int:
    """Convert a distance, or a number of pulses, to signed pulses in the direction in which the chip counts.

    Args:
        axis: Axis that moves.
        distance: Signed distance of the carriage, m (rad on a hinge), or None.
        pulses: Signed pulses, or None.

    Raises:
        ArgumentError: Both are None or both are numbers, or `pulses` is no whole number.
    """
    if (distance is None) == (pulses is None):
        raise ArgumentError(f"distance={distance!r}, pulses={pulses!r}: give one of the two.")
    if pulses is not None:
        if not math.isfinite(pulses) or int(pulses) != pulses:
            raise ArgumentError(f"pulses={pulses!r}: a whole number; the sign is the direction.")
        return int(pulses)
    if not isinstance(distance, int | float) or not math.isfinite(distance):
        raise ArgumentError(f"distance={distance!r} is not a finite number of meters, or of radians on a hinge.")
    return round(get_forward_direction(axis) * distance / _get_meters_per_pulse(axis, "distance"))


def _get_meters_per_pulse(axis: Axis, procedure_name: str) -> float:
    """Return the distance of one pulse, m. Raises ArgumentError for an axis without a carriage."""
    if axis.meters_per_pulse is None:
        raise ArgumentError(
            f"{procedure_name}: axis {axis.name} has no carriage and no metres: give pulses=, and no speed."
        )
    return axis.meters_per_pulse
