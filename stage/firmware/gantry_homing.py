"""Homing of tandem axes, which drive one load side by side, for example a gantry's beam on two screws.

    print(*square_gantry(stage.axes["y"], stage.axes["w"]), sep="\\n")

1. All axes move away from ORG together until every switch is off, then towards it in short moves until the first switch is on.
2. Each axis moves slowly to its own switch. If the switches stand in line, the beam is square afterwards.

The host reads the switches by its own inputs, because not every chip shows their states.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stage.errors import ArgumentError
from stage.firmware.axis import check_direction
from stage.firmware.driver import DEFAULT_RAMP_S, Speeds, get_driver
from stage.firmware.move_report import Report
from stage.firmware.procedures import line, parse_speeds
from stage.firmware.stop_reasons import UNWANTED_REASONS
from stage.firmware.synchronized_report import SynchronizedReport
from stage.sim.axis import Axis
from stage.support.argument_checks import check_timeout

SEARCH_STEP_RATIO = 1 / 60  # of the travel: what the load bears if one axis alone goes so far
SOLO_SPEED_RATIO = 0.25  # of the speed, for an axis alone


def square_gantry(
    *axes: Axis,
    direction: int = -1,
    speed: float | None = None,
    start_speed: float | None = None,
    accel: float = DEFAULT_RAMP_S,
    timeout: float = 60.0,
) -> list[Report]:
    """Home tandem axes from any position, so that each stands at its own origin switch.

    Args:
        axes: All axes that drive the load, see `Axis.tandem`. Their chips must support lines together.
        direction: Direction in which the switches lie, 1 or -1.
        speed: Speed of the common motion, m/s; an axis alone moves at a quarter of it.
        start_speed: Start speed, m/s.
        accel: Time of the ramps, s.
        timeout: Simulated seconds that each axis' own search may take.

    Returns:
        A report of each axis' own search.

    Raises:
        ArgumentError: There are fewer than two axes, one has no origin switch, or the chips support no line together.
        RunTimeout: A search took longer than `timeout`.
    """
    if len(axes) < 2:
        raise ArgumentError(f"{len(axes)} axes: tandem axes are two or more; use home for one.")
    check_direction(direction)
    check_timeout(timeout)
    drivers = [get_driver(axis) for axis in axes]
    for driver in drivers:
        driver.check_origin()
    named = {axis.name: axis for axis in axes}

    def move_together(distance: float) -> SynchronizedReport:
        return line(dict.fromkeys(named, distance), named, speed=speed, start_speed=start_speed, accel=accel)

    piece = SEARCH_STEP_RATIO * min(high - low for low, high in (axis.travel for axis in axes))
    while _is_on_origin(axes) and _is_unobstructed(move_together(-direction * piece)):
        pass
    while not _is_on_origin(axes) and _is_unobstructed(move_together(direction * piece)):
        pass
    reports = []
    for driver in drivers:
        usual = parse_speeds(driver.axis, {"speed": speed, "start_speed": start_speed, "accel": accel})
        alone = Speeds(min(usual.start, usual.drive * SOLO_SPEED_RATIO), usual.drive * SOLO_SPEED_RATIO, accel, accel)
        reports.append(driver.home(direction, alone, timeout=timeout))
    return reports


def square_gantry_at_speeds(
    axes: Sequence[Axis], direction: int, wanted: Speeds, timeout: float = 60.0
) -> list[Report]:
    """Home tandem axes as `square_gantry` does, with speeds in pulses per second of the first axis.

    Args:
        axes: All axes that drive the load.
        direction: 1 or -1.
        wanted: Rates and ramps of the first axis.
        timeout: Simulated seconds that each axis' own search may take.

    Returns:
        A report of each axis' own search.
    """
    unit = axes[0].meters_per_pulse
    return square_gantry(
        *axes, direction=direction, speed=wanted.drive * unit, start_speed=wanted.start * unit, accel=wanted.up,
        timeout=timeout,
    )  # fmt: skip


def group_tandem_axes(axes: Iterable[Axis]) -> list[list[Axis]]:
    """Group axes by the load that they share.

    Args:
        axes: Axes of a stage.

    Returns:
        Groups of axes that move together. A group includes axes that are not among `axes` but share the load; most groups have one
        axis.
    """
    groups: dict[str, list[Axis]] = {}
    for axis in axes:
        everyone = [axis.stage.axes[name] for name in axis.tandem]
        groups.setdefault(min((axis.name, *axis.tandem)), sorted((axis, *everyone), key=lambda a: a.index))
    return list(groups.values())


def _is_on_origin(axes: Sequence[Axis]) -> bool:
    """Return whether one of the axes is on its origin switch."""
    return any(axis.switches.org for axis in axes)


def _is_unobstructed(report: SynchronizedReport) -> bool:
    """Return whether nothing obstructed the move. A servo's encoder may show one count more or less than commanded."""
    return not any(r.stopped_by in UNWANTED_REASONS or r.lost_steps for r in report.axes.values())
