"""The command `stage demo`: origin returns, a move at two rates and a straight line, in half a minute."""

from __future__ import annotations

import argparse
import time
from typing import Any

from stage.cli import options
from stage.cli.command_interface import add_command, add_facts
from stage.cli.output_and_progress import show_simulated_time, show_status
from stage.cli.output_files import record_to_files
from stage.cli.stage_setup import make_stage
from stage.errors import ArgumentError
from stage.support.extras import is_installed
from stage.units import POSITION_UNITS, format_step_count

START_POSITION_SHARES = (0.1962, -0.1435, 0.177)
"""Positions at which the carriages happen to stand, from the middle of their travel, as shares of the travel."""
LONG, SHORT, LINE_FIRST, LINE_SECOND = 0.3956, 0.2894, 0.1978, -0.1085
"""Distances of the moves, as shares of the travel."""
ROUND_PULSES = 500
START_PPS, DRIVE_PPS, FAST_PPS, DWELL_S = 1500, 20_000, 40_000, 0.25
HEADINGS = ("axis", "procedure", "asked", "pulses", "s", "peak pps", "position", "lost", "stopped by", "ok")


def add_subcommand(commands: Any) -> None:
    """Add `stage demo` to argparse's subparsers."""
    p = add_command(
        commands, "demo", run, "home and move three axes, and draw what happened",
        "Home all axes, make a dual-rate move and an a:b move, print a table, and write a recording and a diagram of it.",
        ("stage demo", "move the stage xyz; write demo.rrd and demo.png"),
        ("stage demo --chips mcx514 --model xy --no-window", "use other chips, and open no window"),
        ("stage demo --picture demo.png", "draw the dashboard to a file; needs no screen"),
    )  # fmt: skip
    options.add_stage_and_output_options(p)
    p.set_defaults(default_record="demo.rrd")
    options.add_no_window_option(p, "do not open the viewer even where there is a screen", "--no-view")


def run(args: argparse.Namespace) -> int:
    """Make the moves of the demonstration; return 0 if all went as requested."""
    from stage.firmware.gantry_homing import group_tandem_axes
    from stage.support.opengl import has_screen

    begin = time.perf_counter()
    show_status("building the stage ...")
    stage = make_stage(args)
    for k, group in enumerate(group_tandem_axes(stage.axes.values())):
        low, high = group[0].travel
        place = round(0.5 * (low + high) + START_POSITION_SHARES[k % len(START_POSITION_SHARES)] * (high - low), 3)
        stage.place(**{axis.name: place for axis in group})
    if not (args.record or args.picture or args.web):
        args.default_picture = "demo.png"
    if is_installed("rerun") and has_screen() and not args.no_window and not args.web:
        args.view = True
    with record_to_files(args, stage), show_simulated_time(stage):
        reports = make_moves(stage)
        rows = [format_row(report) for report in reports]
        print(_format_table([HEADINGS, *rows]))
        add_facts(args, reports=reports, seconds=stage.time)
        print(f"{stage.time:.2f} s of simulated time in {time.perf_counter() - begin:.2f} s of wall time")
    return 0 if all(row[-1] == "yes" for row in rows) else 1


def make_moves(stage: Any) -> list[Any]:
    """Make the moves of the demonstration on a stage, and return their reports."""
    from stage import firmware
    from stage.firmware.driver import Speeds
    from stage.firmware.gantry_homing import group_tandem_axes

    speeds = Speeds(START_PPS, DRIVE_PPS, 0.1, 0.1)
    reports: list[Any] = []
    groups = group_tandem_axes(stage.axes.values())
    for group in reversed(groups):  # Z first: it clears the way
        names = " and ".join(axis.name for axis in group)
        if any("org" not in axis.switches.as_dict() for axis in group):
            show_status(f"axis {names} has no ORG: it stays where it is")
            continue
        show_status(f"axis {names}: origin return ...")
        reports += _home_group(group, speeds)
    first, second = (*groups, *groups)[:2]
    if len(first) > 1:
        first, second = second, first
    show_status("a long move ...")
    reports += _move_at_two_rates(first, speeds)
    if second is first:
        return reports
    reports += _move_group(second, SHORT, speeds)
    show_status("a straight line ...")
    pulses: dict[Any, int] = {
        axis: convert_share_to_pulses(axis, share)
        for group, share in ((first, LINE_FIRST), (second, LINE_SECOND))
        for axis in group
    }
    try:
        line = firmware.line(pulses, pulses=True, speed=Speeds(drive=DRIVE_PPS))
    except ArgumentError as error:
        print(f"no straight line: {error}")
        return reports
    moved = " ".join(f"{axis.name}={n:+d}" for axis, n in pulses.items())
    print(
        f"a:b move {moved}: {line.deviation.pulses:.2f} pulses from the straight line at most, started within "
        f"{line.skew * 1e6:.1f} us of each other"
    )
    return [*reports, *line.axes.values()]


def _home_group(group: list[Any], speeds: Any) -> list[Any]:
    """Home one axis or the axes of a gantry together.

    An axis without SD switch, which would reach ORG at its full rate, is homed at half of the rate.
    """
    from stage import firmware

    if len(group) > 1:
        return firmware.square_gantry(*group)
    axis = group[0]
    slowed = "sd_minus" in axis.switches.as_dict() or not axis.chip.find_switch_input("sd_minus")
    return [firmware.home(axis, speed=speeds if slowed else speeds._replace(drive=DRIVE_PPS / 2))]


def _move_group(group: list[Any], share: float, speeds: Any) -> list[Any]:
    """Move one axis, or the axes of a gantry along a line, by a share of the travel."""
    from stage import firmware

    if len(group) == 1:
        return [firmware.move(group[0], pulses=convert_share_to_pulses(group[0], share), speed=speeds)]
    pulses = {axis: convert_share_to_pulses(axis, share) for axis in group}
    return list(firmware.line(pulses, pulses=True, speed=speeds).axes.values())


def _move_at_two_rates(group: list[Any], speeds: Any) -> list[Any]:
    """Move an axis at two rates. The axes of a gantry, and an axis whose travel is too short for two rates, move at one."""
    from stage.firmware.procedures import move_at_two_rates

    if len(group) == 1:
        pulses = convert_share_to_pulses(group[0], LONG)
        try:
            return [move_at_two_rates(group[0], pulses=pulses, speed=speeds.with_second_rate(FAST_PPS), dwell=DWELL_S)]
        except ArgumentError as error:
            show_status(f"no two rates: {error}")
    return _move_group(group, LONG, speeds)


def convert_share_to_pulses(axis: Any, share: float) -> int:
    """Return the signed pulses for a share of the axis' travel, in the opposite direction if there is no room in the given one."""
    low, high = axis.travel
    distance = share * (high - low)
    direction = 1 if distance > 0 else -1
    if not low < axis.position + 1.1 * distance < high:
        direction = -direction
    pulses = abs(distance) / axis.meters_per_pulse
    rounded = max(round(pulses / ROUND_PULSES) * ROUND_PULSES, 1) if pulses > ROUND_PULSES else max(int(pulses), 1)
    return int(rounded * direction * (1 if axis.gear > 0 else -1))


def format_row(report: Any) -> tuple[str, ...]:
    """Return the cells of a report's row in the table."""
    asked = "to ORG" if report.asked is None else f"{report.asked:+d}"
    good = report.ok and (report.stopped_by == "ORG" or report.asked is not None)
    return (
        report.axis, report.procedure, asked, f"{report.pulses:+d}", f"{report.duration:.3f}", f"{report.peak_rate:,.0f}",
        POSITION_UNITS[report.unit].format(report.position), format_step_count(report.lost_steps, report.lost_pulses or 0),
        report.stopped_by, "yes" if good else "NO",
    )  # fmt: skip


def _format_table(rows: list[tuple[str, ...]]) -> str:
    """Format rows of cells as a table with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(v.ljust(w) for v, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])
