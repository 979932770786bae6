"""Tools that move axes: move, home, start, stop, wait, line, and the report of a move as far as the agent may see it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from stage.agents.budget import CALL_LIMIT_S
from stage.agents.tool import Tool
from stage.agents.tool_arguments import (
    Flag,
    LengthWithUnit,
    argument,
    choice,
    integer,
    make_length_mapping_type,
    number,
)
from stage.agents.tool_context import ToolContext
from stage.chips.chip import Chip
from stage.chips.cycle_descriptions import FieldDescriber
from stage.errors import ArgumentError, StageError
from stage.firmware import procedures
from stage.firmware.driver import DEFAULT_RAMP_S, SETTLING_TIME_S, Speeds, wait_until_stopped
from stage.firmware.gantry_homing import square_gantry_at_speeds
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.stop_reasons import UNWANTED_REASONS
from stage.firmware.synchronized_report import SynchronizedReport
from stage.units import POSITION_UNITS

DIRECTIONS = {"minus": -1, "plus": 1}
MIN_RATE_PPS = 0.01
HOME_TIMEOUT_S = 60.0
BUS_MOVE_LABEL = "started by bus cycles"
"""Procedure of a move that no driver has started: only its host knows whether it went as asked."""


class MotionTools:
    """Tools that move axes. They watch each move that was started until a tool waits for its end."""

    def __init__(self, context: ToolContext):
        self._context = context
        self._watched: dict[str, tuple[ProcedureObserver, int | None]] = {}
        self._stop_commands: dict[str, str] = {}  # with which a host has stopped an axis

    def list_tools(self) -> list[Tool]:
        """List the tools. The tool `line` exists only on a stage with several axes."""
        context = self._context
        axis = {"axis": context.axis_argument}
        how_far = {
            "distance": argument(LengthWithUnit, 'Signed distance with its unit, such as "10mm" or "30deg"; or give pulses.', None),
            "pulses": argument(integer(), "Signed number of pulses; of a servo, counts.", None),
        }  # fmt: skip
        how_fast = {
            "speed": argument(number(gt=0), "Speed of the move in m/s (rad/s); default 16,000 pulses a second.", None),
            "start_speed": argument(number(gt=0), "Speed in m/s (rad/s) at which ramps begin.", None),
            "accel": argument(number(gt=0), "Duration of the ramp up in s.", DEFAULT_RAMP_S),
        }
        ramps = {
            "decel": argument(number(gt=0), "Duration of the ramp down in s; default: as accel.", None),
            "s_curve": argument(Flag, "Ramps without corners, where the chip has them.", None),
        }
        timeout = {
            "timeout": argument(number(gt=0, le=CALL_LIMIT_S), "Simulated seconds after which to give up.", None)
        }
        homings = tuple(
            dict.fromkeys(h for name in context.axes for h in context.get_driver(name).list_homing_methods())
        )
        direction = argument(choice(tuple(DIRECTIONS)), "Direction in which ORG lies.", "minus")
        by = argument(choice(homings), "What ends the return; default: the chip's usual.", None)
        timeout_s = argument(number(gt=0, le=CALL_LIMIT_S), "Simulated seconds after which to give up.", 30.0)
        move, make, example = {**axis, **how_far, **how_fast, **ramps}, Tool.from_method, {"distance": "10mm"}
        tools = [
            make(self.move, {**move, **timeout}, moves=True, example=example),
            make(self.home, {**axis, "direction": direction, "by": by, **how_fast, **timeout}, moves=True),
            make(self.start, move, moves=True, example=example),
            make(self.stop, {**axis, "at_once": argument(Flag, "Stop without a ramp.", None)}),
            make(self.wait, {"seconds": argument(number(ge=0, le=CALL_LIMIT_S), "Simulated seconds.")}),
            make(self.wait_until_stopped, {**axis, "timeout": timeout_s}),
            make(self.report, free=True),
        ]
        if len(context.axes) > 1:
            distances = argument(
                make_length_mapping_type(context.axes),
                'Signed distances by axis with their units, such as "10mm".',
            )
            arguments = {"distances": distances, **how_fast, "s_curve": ramps["s_curve"], **timeout}
            tools.append(make(self.line, arguments, moves=True))
        return tools

    # --- tools ---

    def move(self, axis: str, **values: Any) -> dict[str, Any]:
        """Move an axis by a distance and wait for the end. Returns the report."""
        pulses, speeds = self._parse_move(axis, values)
        self._require_rest([axis])
        return self._store_report(self._context.get_driver(axis).move(pulses, speeds, values.get("timeout")))

    def home(self, axis: str, direction: str, by: str | None = None, **values: Any) -> dict[str, Any]:
        """Return to the mechanical origin ORG from any place. Returns the report."""
        speeds, timeout = self._parse_speeds(axis, values), values.get("timeout", HOME_TIMEOUT_S)
        if tandem := self._context.get_axis(axis).tandem:
            if by is not None:
                raise ArgumentError(f"by={by!r}: axis {axis} drives one load with {', '.join(tandem)}; leave it out.")
            self._require_rest([axis, *tandem])
            axes = [self._context.get_axis(name) for name in (axis, *tandem)]
            reports = square_gantry_at_speeds(axes, DIRECTIONS[direction], speeds, timeout)
            return {
                "procedure": "home of axes that drive one load",
                "axes": {r.axis: self._store_report(r) for r in reports},
            }
        driver = self._context.get_driver(axis)
        self._require_rest([axis])
        by = by or driver.list_homing_methods()[0]
        driver.check_homing(by)
        return self._store_report(driver.home_by(by, DIRECTIONS[direction], speeds, timeout))

    def line(self, distances: dict[str, float], s_curve: bool = False, **values: Any) -> dict[str, Any]:
        """Move several axes along a straight line. Returns the report."""
        self._require_rest(distances)
        return self._store_report(procedures.line(distances, self._context.stage.axes, s_curve=s_curve, **values))

    def start(self, axis: str, **values: Any) -> dict[str, Any]:
        """Start a move and return at once: wait or wait_until_stopped let time pass."""
        pulses, speeds = self._parse_move(axis, values)
        driver = self._context.get_driver(axis)
        self._require_rest([axis])
        self._begin_watching(axis, "move", pulses)
        try:
            driver.start(pulses, speeds)
        except BaseException:
            self._stop_watching(axis)
            raise
        return {"axis": axis, "started": True, "pulses": pulses, "time_s": self._context.time_s}

    def stop(self, axis: str, at_once: bool = False) -> dict[str, Any]:
        """Stop an axis, with a ramp or at once, and wait until it rests."""
        self._context.get_driver(axis).halt(at_once)
        return self._report_watched_move(axis, "stopped by the host")

    def wait(self, seconds: float) -> dict[str, Any]:
        """Let simulated time pass."""
        self._context.stage.run(seconds)
        return {"waited_s": seconds, "time_s": self._context.time_s}

    def wait_until_stopped(self, axis: str, timeout: float) -> dict[str, Any]:
        """Poll the status of an axis until it has stopped. Returns the report of its move."""
        a, driver = self._context.get_axis(axis), self._context.get_driver(axis)
        if axis in self._watched and self._watched[axis][0].name != BUS_MOVE_LABEL:
            reason = driver.wait(timeout)
        else:
            wait_until_stopped([a], timeout)
            reason = self._describe_status(axis)
        a.wait(SETTLING_TIME_S)
        return self._report_watched_move(axis, reason, self._stop_commands.pop(axis, ""))

    def report(self) -> dict[str, Any]:
        """Show the report of the last move."""
        if self._context.report is None:
            raise StageError("There is no report yet: move, home, line or start with wait_until_stopped make one.")
        return describe_report(self._context.report, self._context.mode)

    # --- moves that are watched ---

    def watch_write(self, chip: Chip, address: int, value: int) -> None:
        """Check a write of the host before it is made.

        If the write starts a move, count the move and watch it. If the write stops a watched move, note that for its report.

        Args:
            chip: The chip.
            address: Address of the write.
            value: Value of the write.
        """
        for a in self._context.stage.axes.values():
            if a.chip is not chip:
                continue
            if a.name in self._watched and chip.busy(a.chip_axis):
                if self._context.get_driver(a.name).is_stop_command(address, value):
                    self._stop_commands[a.name] = f"stopped by the host: {value:0{chip.DATA_MASK.bit_length() // 4}X}h"
            elif chip.would_start_drive(address, value, a.chip_axis):
                self._context.meter.count_move()
                self._stop_watching(a.name)
                self._begin_watching(a.name, BUS_MOVE_LABEL, None)

    def stop_watching_all(self) -> None:
        """Stop watching the moves of all axes."""
        for name in tuple(self._watched):
            self._stop_watching(name)

    def _begin_watching(self, axis: str, procedure: str, pulses: int | None) -> None:
        """Observe a move of an axis from now on, to make its report later; `pulses` is its length, None if unknown."""
        self._stop_commands.pop(axis, None)
        self._watched[axis] = ProcedureObserver(self._context.get_axis(axis), procedure).__enter__(), pulses

    def _stop_watching(self, axis: str) -> None:
        """Stop watching the move of an axis without a report."""
        if axis in self._watched:
            self._watched.pop(axis)[0].__exit__(None, None, None)

    def _require_rest(self, axes: Iterable[str]) -> None:
        """Raise ArgumentError if one of the axes moves; else stop watching their earlier moves."""
        for name in axes:
            a = self._context.get_axis(name)
            if a.chip.make_replica().busy(a.chip_axis):  # a driver would need a bus cycle to find out
                raise ArgumentError(f"axis {name} is moving: wait_until_stopped waits for its end, and stop stops it.")
        for name in axes:
            self._stop_watching(name)

    def _describe_status(self, axis: str) -> str:
        """Describe from the status why a move ended that the host had started by bus cycles."""
        places = {p.name: p for p in self._context.get_axis(axis).chip.MAP.places}
        words = self._context.get_driver(axis).read_status_words()
        return "; ".join(FieldDescriber(places[name]).describe(name, value) for name, value in words.items())

    def _report_watched_move(self, axis: str, reason: str, stop_command: str = "") -> dict[str, Any]:
        """End the watch of an axis' move, and return its report as the tool's result.

        Args:
            axis: Name of the axis.
            reason: Why the move ended, as the host driver or the status says.
            stop_command: Description of the host's stop command, or "".
        """
        if axis not in self._watched:
            return {"axis": axis, "at_rest": True, "time_s": self._context.time_s}
        procedure, pulses = self._watched.pop(axis)
        report = procedure.make_report(reason, pulses)
        if stop_command and report.pulses != pulses:  # no status bit shows it, and a driver guesses from what is left
            report = replace(report, stopped_by=stop_command)
        return self._store_report(report)

    # --- arguments and results ---

    def _parse_move(self, axis: str, values: dict[str, Any]) -> tuple[int, Speeds]:
        """Return the signed number of pulses and the speeds for the arguments of a move."""
        a, distance, pulses = self._context.get_axis(axis), values.get("distance"), values.get("pulses")
        if (distance is None) == (pulses is None):
            raise ArgumentError('give distance ("10mm") or pulses, one of the two.')
        number = procedures.convert_to_pulses(a, distance, pulses)
        low, high = procedures.find_travel_range(a)
        if distance is not None and abs(distance) > high - low:  # no position: a host does not know it
            unit = POSITION_UNITS[a.unit]
            raise ArgumentError(
                f"distance: {unit.format(distance, 'g')} is more than the travel of axis {axis}, "
                f"{low * unit.factor:g} to {unit.format(high, 'g')}. Give a shorter distance, or pulses."
            )
        if not number:
            raise ArgumentError(
                f"no pulse: a pulse of axis {axis} is {a.meters_per_pulse:g} {a.unit}; ask for one at least."
            )
        return number, self._parse_speeds(axis, values)

    def _parse_speeds(self, axis: str, values: dict[str, Any]) -> Speeds:
        """Return the speeds for the arguments of a move. Raises ArgumentError for a speed below MIN_RATE_PPS."""
        a, (speed, start_speed) = self._context.get_axis(axis), (values.get(n) for n in ("speed", "start_speed"))
        least = MIN_RATE_PPS * a.meters_per_pulse
        for name, value in (("speed", speed), ("start_speed", start_speed)):
            if value is not None and value < least:
                raise ArgumentError(
                    f"{name}: {value:g} is too slow; the least is {least:g} {a.unit}/s, {MIN_RATE_PPS:g} pulses a second."
                )
        return procedures.parse_speeds(a, values)

    def _store_report(self, report: Any) -> dict[str, Any]:
        """Store a report as that of the last move, and return it as the tool's result."""
        self._context.report = report
        return describe_report(report, self._context.mode)


def describe_report(report: Report | SynchronizedReport, mode: str) -> dict[str, Any]:
    """Describe a report as far as an agent of this mode may see it.

    Args:
        report: Report of a move or of a line.
        mode: "host": pulses by the chip's counters, the time from the start to the interrupt at the stop, and the reason of the
            stop as registers show it. "truth": also the position of the carriage, lost steps and the true rates.

    Returns:
        JSON values by name.
    """
    if isinstance(report, SynchronizedReport):
        axes = {name: describe_report(r, mode) for name, r in report.axes.items()}
        line: dict[str, Any] = {
            "procedure": "line",
            "as_asked": all(a["as_asked"] for a in axes.values()),
            "axes": axes,
        }
        if mode == "truth":
            line["off_the_line_pulses"] = round(report.deviation.pulses, 3)
            line["carriage_off_m"] = report.carriage_deviation
        return line
    complete = report.asked is None or report.pulses == report.asked
    as_asked = None if report.procedure == BUS_MOVE_LABEL else complete and report.stopped_by not in UNWANTED_REASONS
    answer: dict[str, Any] = {
        "procedure": report.procedure, "axis": report.axis, "as_asked": as_asked,
        "stopped_by": report.stopped_by, "asked_pulses": report.asked, "counted_pulses": report.pulses,
        "duration_s": round(report.duration, 9),
    }  # fmt: skip
    if report.residual is not None:
        answer["R0_left"] = report.residual
    if mode == "truth":
        answer |= {
            "as_asked": as_asked and report.ok, "lost_steps": report.lost_steps, "from": report.start, "to": report.position,
            "peak_rate_pps": round(report.peak_rate, 3),
        }  # fmt: skip
    return answer
