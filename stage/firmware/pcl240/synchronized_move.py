"""The a:b move: several chips, one straight line.

    machine = Stage("xyz")
    report = synchronized_move({"x": 20_000, "y": -7_500}, machine)

The move is planned, written to the chips, and started by one start command after the other, the longest axis last.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from stage.chips.exclusive_access import exclusive
from stage.errors import ArgumentError, RunTimeout, add_article
from stage.firmware.axis import AxesByName, Axis
from stage.firmware.pcl240 import chip_port
from stage.firmware.pcl240.chip_port import check_chip_family, describe_leader, require_clock
from stage.firmware.pcl240.line_plan import Plan, plan
from stage.firmware.pcl240.moves import SETTLING_TIME_S
from stage.firmware.pcl240.procedure_observer import Pcl240Observer
from stage.firmware.pcl240.speed_profile import DEFAULT_RAMP_TIME_S, FH1, FL
from stage.firmware.synchronized_report import LineObserver, SynchronizedReport, select_axes
from stage.support.argument_checks import check_timeout, explain_arguments

MIN_DELAY_GAIN_PULSES = 0.02  # pulses that a plan for the bus delay may be better than one for a common start
MAX_POLLS = 200  # at the status bytes of a long move


@explain_arguments
@exclusive
def synchronized_move(
    distances: Mapping[str, int] | Mapping[Axis, int] | Plan,
    axes: AxesByName = None,
    *,
    rate: float = FH1,
    fl: float = FL,
    accel: float = DEFAULT_RAMP_TIME_S,
    decel: float | None = None,
    s_curve: bool | float = False,
    automatic: bool | None = None,
    timeout: float | None = None,
) -> SynchronizedReport:
    """Move several axes along a straight line, by bus cycles only.

    A status read shows how long a bus cycle takes, and the plan takes this time into account. If an end limit stops an axis, the
    other axes slow down and stop, because the line is lost.

    Args:
        distances: Axis name (or axis) -> signed pulses; 0 keeps an axis still. Or a Plan made before.
        axes: Stage, bench, or mapping such as stage.axes in which the names are found. Not needed if the keys are axes.
        rate: FH of the longest axis, pps.
        fl: FL of the longest axis, pps.
        accel: Time of the ramp up, s.
        decel: Time of the ramp down, s; default: `accel`.
        s_curve: True for S-curves throughout, a fraction (above 0, up to 0.5) of FH - FL for curved ends, False for linear ramps.
            Every axis that moves needs a PCL240MS for it.
        automatic: Whether the chips find the ramp-down point themselves, and decelerate as they accelerated (PCL240MK and
            PCL240MS).
            Default: False; the plan computes the point.
        timeout: Simulated seconds for the motion; default: half as much again as the plan takes, and one.

    Returns:
        A report of all axes.

    Raises:
        ArgumentError: The chips cannot do it; the message has the reason.
        RunTimeout: An axis still moved after `timeout`; `reports` of the error says how far each axis came.
    """
    check_timeout(timeout)
    if not isinstance(distances, Mapping | Plan):
        distances, axes = axes, distances
    if isinstance(distances, Plan):
        selected = _select_axes(distances.distances, axes)
        _check_same_chips(distances, selected)
        _check_clocks(distances, selected)
        line_plan = distances.with_bus_delay(_measure_bus_delay(selected, distances.order))
    else:
        selected = _select_axes(distances, axes)
        requested = {n: d for n, (_, d) in selected.items()}
        chips: dict[str, Any] = {n: type(a.chip) for n, (a, _) in selected.items()}
        clocks = {n: a.chip.clock_hz for n, (a, _) in selected.items()}
        wanted = partial(
            plan, requested, rate=rate, fl=fl, accel=accel, decel=decel, s_curve=s_curve, automatic=automatic,
            chips=chips, clock_hz=clocks, **_find_clock_arguments({n: a for n, (a, d) in selected.items() if d}),
        )  # fmt: skip
        at_once = wanted()  # refuses before the first bus cycle
        delay = _measure_bus_delay(selected, at_once.order)
        line_plan = at_once.with_bus_delay(delay)
        if line_plan.deviation > at_once.deviation + MIN_DELAY_GAIN_PULSES:
            line_plan = wanted(bus_delay=delay)
    return _run_plan({n: selected[n][0] for n in line_plan.order}, line_plan, timeout)


def _run_plan(axes: dict[str, Axis], line_plan: Plan, timeout: float | None) -> SynchronizedReport:
    """Write the registers of a line's plan, start the axes in its order, wait for their end, and return the report."""
    watch = {n: Pcl240Observer(a, "synchronized move") for n, a in axes.items()}
    with LineObserver(watch, line_plan.distances) as line:
        for n, p in watch.items():
            p.port.write_command(chip_port.RESET)
            p.port.write_registers(**line_plan.axes[n].registers)
            p.port.write_command(chip_port.OUTPUT)
            minus = chip_port.MINUS if line_plan.axes[n].distance < 0 else 0
            p.port.write_control_mode(
                chip_port.PRESET | minus | (chip_port.AUTOMATIC if line_plan.axes[n].automatic else 0)
            )
        for n, p in watch.items():  # nothing between the starts but the bus
            p.port.write_command(
                chip_port.RAMP_START_COMMANDS["FH1"] if line_plan.axes[n].has_ramps else chip_port.START["FH1"]
            )
            line.note_start(n)
        with line.attach_reports_to_timeout():
            stopped_by = _wait_for_axes(
                watch, line_plan, 1.5 * line_plan.seconds + 1 if timeout is None else timeout, line
            )
        next(iter(axes.values())).wait(SETTLING_TIME_S)
        return line.make_report(stopped_by, line_plan)


def _wait_for_axes(
    observer: dict[str, Pcl240Observer], line_plan: Plan, timeout_s: float, line: LineObserver
) -> dict[str, str]:
    """Poll all axes until none moves; return the stop reason of each axis."""
    stopped_by: dict[str, str] = {}
    broken = False
    clock = next(iter(observer.values())).axis
    begin = clock.time
    while True:
        for n, p in observer.items():
            if n in stopped_by:
                continue
            if not p.port.read_status().operating:
                stopped_by[n] = p.find_stop_reason()
        line.measure_carriages()
        if len(stopped_by) == len(observer):
            return stopped_by
        if not broken and any(s.startswith("EL") for s in stopped_by.values()):
            broken = True
            for n, p in observer.items():
                if n not in stopped_by:
                    p.port.write_command(chip_port.SLOW_DOWN["FH1"])
        passed = clock.time - begin
        if passed >= timeout_s:
            left = {n: observer[n].port.read_counter() for n in observer if n not in stopped_by}
            raise RunTimeout(
                f"after {timeout_s:.3f} s axes still operate; pulses left: {left}. Give more time, or stop them with 08h."
            )
        poll = (
            chip_port.POLL_INTERVAL_S
            if line.carriages.worst is not None
            else max(chip_port.POLL_INTERVAL_S, line_plan.seconds / MAX_POLLS)
        )
        clock.wait(min(poll, timeout_s - passed + 1e-6))


def _select_axes(distances: Mapping, axes: Any) -> dict[str, tuple[Axis, int]]:
    """Find the axes of a move as `select_axes` does. Raises ArgumentError also for chips of another family."""
    selected = select_axes(distances, axes, "synchronized_move")
    for axis, _ in selected.values():
        check_chip_family(axis)
    return selected


def _check_same_chips(line_plan: Plan, selected: dict[str, tuple[Axis, int]]) -> None:
    """Raise ArgumentError for a plan of a line that was made for other chips or clocks than those of the axes."""
    for n, a in line_plan.axes.items():
        if type(selected[n][0].chip) is not a.chip:
            raise ArgumentError(
                f"the plan is for {add_article(a.chip.MAP.chip)}, and axis {n} has {add_article(selected[n][0].chip.MAP.chip)}: "
                f"plan with chips={{{n!r}: {type(selected[n][0].chip).__name__}}}."
            )
        if selected[n][0].chip.clock_hz != a.clock_hz:
            raise ArgumentError(
                f"the plan is for a chip at {a.clock_hz} Hz, and axis {n}'s runs at {selected[n][0].chip.clock_hz} Hz: "
                f"plan with clock_hz={{{n!r}: {selected[n][0].chip.clock_hz}}}."
            )


def _find_clock_arguments(moving: Mapping[str, Axis]) -> dict[str, Any]:
    """Return the arguments `multipliers` and `shared` of `plan`. Raises StageError for a follower whose leader makes no clock."""
    multipliers: dict[str, int] = {}
    shared: set[str] = set()
    for n, axis in moving.items():
        leader = getattr(axis.chip, "syni", None)
        along = [other for other, a in moving.items() if a.chip is leader]
        if along:
            shared.update((n, *along))
        elif (multiplier := require_clock(axis)) is not None:
            multipliers[n] = multiplier
    return {"multipliers": multipliers, "shared": shared}


def _check_clocks(line_plan: Plan, selected: dict[str, tuple[Axis, int]]) -> None:
    """Raise ArgumentError if the plan of a follower has another R7 than the leader whose clock the follower's chip counts."""
    clocks = _find_clock_arguments({n: selected[n][0] for n in line_plan.axes})
    for n, a in line_plan.axes.items():
        leaders = [m for m in line_plan.axes if selected[m][0].chip is getattr(selected[n][0].chip, "syni", None)]
        multiplier = (
            line_plan.axes[leaders[0]].registers["R7"] if leaders else clocks["multipliers"].get(n, a.registers["R7"])
        )
        if multiplier != a.registers["R7"]:
            raise ArgumentError(
                f"the plan has R7 = {a.registers['R7']} for axis {n}, whose chip counts the clock of "
                f"{describe_leader(selected[n][0])} "
                f"(SYNI) with R7 = {multiplier}: plan with {clocks}."
            )


def _measure_bus_delay(selected: dict[str, tuple[Axis, int]], names: Any) -> float:
    """Check that each axis is at rest by a status read, and return the time that a bus cycle takes, s."""
    delay = 0.0
    for n in names:
        axis = selected[n][0]
        before = axis.time
        if chip_port.ChipPort(axis).read_status().operating:
            raise ArgumentError(f"axis {n} is moving: wait until it stops, or stop it with 08h.")
        delay = axis.time - before
    return delay
