"""Home of tandem axes, which drive one load side by side: a gantry's beam on two screws.

    print(*square(stage.axes["y"], stage.axes["w"]), sep="\\n")

    together   away from ORG, until no switch of them is on any more; then towards it, a little at a time, until one is
    each       to its own switch, slowly: where the switches stand in line, the beam is square then

A switch's state comes from an input of the host's own: not every chip shows it.
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
    """Return tandem axes to their origins, which lie in `direction`, from any position.

    Args:
        axes: All axes that drive the load, see `Axis.tandem`; their chips draw lines together.
        direction: 1 or -1.
        speed: Speed of the common motion, m/s; an axis alone moves at a quarter of it.
        start_speed: Start speed, m/s.
        accel: Time of the ramps, s.
        timeout: Simulated seconds that each axis' own search may take.

    Returns:
        A report of each axis' own search.

    Raises:
        ArgumentError: Fewer than two axes, an axis without ORG, or chips that draw no line together.
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
    """Square axes as `square_gantry` does, at speeds in pulses per second of the first axis.

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
    """Group axes that move together, most of them alone; axes that share a load with them are added.

    Args:
        axes: Axes of a stage.

    Returns:
        Groups of axes.
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
    """Return whether nothing was in the way. A servo's encoder may show a count less, or more, than commanded."""
    return not any(r.stopped_by in UNWANTED_REASONS or r.lost_steps for r in report.axes.values())
