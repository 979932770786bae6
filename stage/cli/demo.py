"""`stage demo`: the whole story in half a minute."""

from __future__ import annotations

import argparse
import time
from typing import Any

from stage.cli.facts import tell
from stage.cli.files import recorded
from stage.cli.progress import note, ticking
from stage.cli.setup import make_stage
from stage.errors import ArgumentError
from stage.support.extras import has
from stage.units import PLACES

WHERE = (0.1962, -0.1435, 0.177)  # where the carriages happen to stand, from the middle of their travel, in travels
LONG, SHORT, FIRST, SECOND = 0.3956, 0.2894, 0.1978, -0.1085  # moves, in travels
ROUND = 500  # pulses
RATE, FAST, DWELL = 20_000, 40_000, 0.25  # pps, pps, s


def run(args: argparse.Namespace) -> int:
    """Origin return of all axes, a dual-rate move, an a:b move; a table; demo.rrd."""
    from stage.firmware.tandem import tandems
    from stage.support.opengl import has_screen

    begin = time.perf_counter()
    note("building the stage ...")
    stage = make_stage(args)
    for k, group in enumerate(tandems(stage.axes.values())):
        low, high = group[0].travel
        where = round(0.5 * (low + high) + WHERE[k % len(WHERE)] * (high - low), 3)
        stage.place(**{axis.name: where for axis in group})
    if has("rerun") and has_screen() and not args.no_view and not args.web:
        args.view = True
    rows: list[tuple] = []
    with recorded(args, stage), ticking(stage):
        reports = story(stage, rows)
        print(_table(rows))
        tell(args, reports=reports, seconds=stage.time)
        wall = time.perf_counter() - begin
        print(f"{stage.time:.2f} s of simulated time in {wall:.2f} s of wall time")
    return 0 if all(r[-1] == "yes" for r in rows) else 1


def story(stage: Any, rows: list[tuple]) -> list[Any]:
    """The moves; fills `rows` for the table. Returns their reports."""
    from stage.firmware.driver import Speeds
    from stage.firmware.tandem import tandems

    speeds = Speeds(1500, RATE, 0.1, 0.1)
    reports: list[Any] = []

    def add(report: Any) -> None:
        reports.append(report)
        homed = report.stopped_by == "ORG"
        asked = "to ORG" if report.asked is None else f"{report.asked:+d}"
        good = report.ok and (homed or report.asked is not None)
        rows.append(
            (
                report.axis, report.procedure, asked, f"{report.pulses:+d}", f"{report.duration:.3f}",
                f"{report.peak_rate:,.0f}", PLACES[report.unit].text(report.position), str(report.lost_steps),
                report.stopped_by, "yes" if good else "NO",
            )
        )  # fmt: skip

    groups = tandems(stage.axes.values())
    for group in reversed(groups):  # Z first: it clears the way
        names = " and ".join(axis.name for axis in group)
        if any("org" not in axis.switches.as_dict() for axis in group):
            note(f"axis {names} has no ORG: it stays where it is")
            continue
        note(f"axis {names}: origin return ...")
        for report in _home(group, speeds):
            add(report)
    first, second = (*groups, *groups)[:2]
    if len(first) > 1:
        first, second = second, first
    note("a long move ...")
    for report in _long_move(first, speeds):
        add(report)
    if second is first:
        return reports
    for report in _go(second, SHORT, speeds):
        add(report)
    kinds = {type(axis.chip) for axis in (*first, *second)}
    if len(kinds) > 1:
        print(f"axes {first[0].name} and {second[0].name} have different chips, which draw no line together")
        return reports
    note("a straight line ...")
    ways = {axis: _way(axis, share) for group, share in ((first, FIRST), (second, SECOND)) for axis in group}
    try:
        line = _line(ways, Speeds(drive=RATE))
    except ArgumentError as error:
        print(f"no straight line: {error}")
        return reports
    for r in line.axes.values():
        add(r)
    what = "a:b move " + " ".join(f"{axis.name}={pulses:+d}" for axis, pulses in ways.items())
    print(
        f"{what}: {line.deviation.pulses:.2f} pulses from the straight line at most, started within "
        f"{line.skew * 1e6:.1f} us of each other"
    )
    return reports


def _home(group: list[Any], speeds: Any) -> list[Any]:
    """Tandem axes together. An axis without SD runs into ORG at its full rate: half of it."""
    from stage import firmware
    from stage.firmware.driver import driver_of

    if len(group) > 1:
        return firmware.square(*group)
    axis = group[0]
    slowed = "sd_minus" in axis.switches.as_dict() or not axis.chip.wired("sd_minus")
    return [driver_of(axis).home(-1, speeds if slowed else speeds._replace(drive=RATE / 2))]


def _go(group: list[Any], share: float, speeds: Any) -> list[Any]:
    from stage.firmware.driver import driver_of

    if len(group) == 1:
        return [driver_of(group[0]).move(_way(group[0], share), speeds)]
    return list(_line({axis: _way(axis, share) for axis in group}, speeds).axes.values())


def _line(ways: dict[Any, int], speeds: Any) -> Any:
    from stage.firmware.driver import driver_of

    drivers = {axis.name: driver_of(axis) for axis in ways}
    first = next(iter(drivers.values()))
    return first.line(drivers, {axis.name: pulses for axis, pulses in ways.items()}, speeds)


def _long_move(group: list[Any], speeds: Any) -> list[Any]:
    """At two rates; of an axis too short for them, and of tandem axes, at one."""
    from stage.firmware.driver import driver_of

    if len(group) == 1:
        try:
            return [driver_of(group[0]).two_rates(_way(group[0], LONG), speeds, FAST, DWELL)]
        except ArgumentError as error:
            note(f"no two rates: {error}")
    return _go(group, LONG, speeds)


def _way(axis: Any, share: float) -> int:
    """Pulses of a share of the axis' travel, signed; the other way where there is no room for it."""
    low, high = axis.travel
    way = share * (high - low)
    side = 1 if way > 0 else -1
    if not low < axis.position + 1.1 * way < high:
        side = -side
    pulses = abs(way) / axis.meters_per_pulse
    rounded = max(round(pulses / ROUND) * ROUND, 1) if pulses > ROUND else max(int(pulses), 1)
    return int(rounded * side * (1 if axis.gear > 0 else -1))


def _table(rows: list[tuple]) -> str:
    head = ("axis", "procedure", "asked", "pulses", "s", "peak pps", "position", "lost", "stopped by", "ok")
    widths = [max(len(str(r[k])) for r in (head, *rows)) for k in range(len(head))]
    lines = ["  ".join(str(v).ljust(w) for v, w in zip(r, widths, strict=True)).rstrip() for r in (head, *rows)]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])
