"""Tools that move: start, stop, wait, move, home, line, and the report of what came of it, as the agent may see it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from stage.agents.budget import LONGEST
from stage.agents.bus import axis_field
from stage.agents.fields import FLAG, LENGTH, LENGTHS, NUMBER, TEXT, WHOLE, Field
from stage.agents.tool import Tool
from stage.chips.chip import Chip
from stage.chips.describe import Fields
from stage.errors import ArgumentError, StageError
from stage.firmware import procedures
from stage.firmware.driver import RAMP, SETTLE, wait_until_stopped
from stage.firmware.report import Procedure, Report
from stage.firmware.stop_reasons import NOT_AS_ASKED
from stage.firmware.tandem import square_by
from stage.firmware.together import SynchronizedReport

if TYPE_CHECKING:
    from stage.agents.toolbox import Toolbox

WAYS = ("minus", "plus")
TEN = {"distance": "10mm"}
SLOWEST = 0.01  # pulses a second
BY_ITSELF = "started by bus cycles"
"""What a report calls a move that no driver has started: whether it is as asked, its host alone knows."""


class Motion:
    """Acts for the tools. It watches what a start has begun until it is waited for."""

    def __init__(self, box: Toolbox):
        self._box = box
        self._watched: dict[str, tuple[Procedure, int | None]] = {}
        self._stops: dict[str, str] = {}  # the command by which a host has stopped a drive

    def tools(self) -> list[Tool]:
        """Of the toolbox."""
        box = self._box
        axis = axis_field(box)
        unit = "m, or rad on a hinge; or a text with its unit"
        how_far = (
            Field("distance", LENGTH, f'signed, {unit}, as "10mm"; or give pulses'),
            Field("pulses", WHOLE, "so many, signed; of a servo counts"),
        )
        how_fast = (
            Field(
                "speed", NUMBER, "of the drive; default 16,000 pulses a second", low=0.0, above=True, unit="m/s (rad/s)"
            ),
            Field("start_speed", NUMBER, "at which ramps begin", low=0.0, above=True, unit="m/s (rad/s)"),
            Field("accel", NUMBER, "of the ramp up", default=RAMP, low=0.0, above=True, unit="s"),
        )
        down = Field("decel", NUMBER, "of the ramp down; as accel if not given", low=0.0, above=True, unit="s")
        curved = Field("s_curve", FLAG, "ramps without corners, where the chip has them")
        timeout = Field("timeout", NUMBER, "give up after so long", low=0.0, above=True, high=LONGEST, unit="s")
        homings = tuple(dict.fromkeys(h for name in box.axes for h in box.driver(name).homings()))
        made = [
            Tool(
                "move", "Move an axis by a distance, and wait until it is there. Returns the report.", self.move,
                (axis, *how_far, *how_fast, down, curved, timeout), moves=True, shows=TEN,
            ),
            Tool(
                "home", "Return to the mechanical origin ORG from any place. Returns the report.", self.home,
                (axis, Field("direction", TEXT, "in which ORG lies", default="minus", choices=WAYS),
                 Field("by", TEXT, "what to home by; default the chip's usual", choices=homings), *how_fast, timeout), moves=True,
            ),
            Tool(
                "start", "Start a move and do not wait: wait or wait_until_stopped let time pass.", self.start,
                (axis, *how_far, *how_fast, down, curved), moves=True, shows=TEN,
            ),
            Tool("stop", "Stop an axis, with a ramp or at once, and wait until it rests.", self.stop,
                 (axis, Field("at_once", FLAG, "without a ramp"))),
            Tool("wait", "Let simulated time pass.", self.wait,
                 (Field("seconds", NUMBER, "how long", True, low=0.0, high=LONGEST, unit="s"),)),
            Tool(
                "wait_until_stopped", "Poll the status of an axis until it does not drive. Returns the report of its move.",
                self.wait_until_stopped,
                (axis, replace(timeout, default=30.0)),
            ),
            Tool("report", "The report of the last move.", self.report, free=True),
        ]  # fmt: skip
        if len(box.axes) > 1:
            distances = Field("distances", LENGTHS, f"by axis, {unit}", True, choices=box.axes)
            given = (distances, *how_fast, curved, timeout)
            text = "Move several axes along a straight line. Returns the report."
            made.append(Tool("line", text, self.line, given, moves=True))
        return made

    # --- tools ---

    def move(self, axis: str, **given: Any) -> dict[str, Any]:
        a = self._box.axis(axis)
        pulses, speeds = self._asked(axis, given)
        self._at_rest(axis)
        self._end(axis)
        return self._done(self._box.driver(axis).move(pulses, speeds, given.get("timeout")), a.name)

    def home(self, axis: str, direction: str, by: str | None = None, **given: Any) -> dict[str, Any]:
        if self._box.axis(axis).tandem:
            return self._square(axis, direction, by, given)
        driver = self._box.driver(axis)
        self._at_rest(axis)
        self._end(axis)
        what = driver.homings()[0] if by is None else by
        driver.check_homing(what)
        speeds = self._speeds(axis, given)
        return self._done(driver.home_by(what, WAYS.index(direction) * 2 - 1, speeds, given.get("timeout", 60.0)), axis)

    def line(self, distances: dict[str, float], s_curve: bool = False, **given: Any) -> dict[str, Any]:
        for axis in distances:
            self._at_rest(axis)
        for axis in distances:
            self._end(axis)
        return self._done(procedures.line(distances, self._box.stage.axes, s_curve=s_curve, **given), "line")

    def start(self, axis: str, **given: Any) -> dict[str, Any]:
        pulses, speeds = self._asked(axis, given)
        driver = self._box.driver(axis)
        self._at_rest(axis)
        self._end(axis)
        watched = self._watch(axis, "move", pulses)
        try:
            driver.start(pulses, speeds)
        except BaseException:
            watched.__exit__(None, None, None)
            del self._watched[axis]
            raise
        return {"axis": axis, "started": True, "pulses": pulses, "time_s": round(self._box.stage.time, 9)}

    def stop(self, axis: str, at_once: bool = False) -> dict[str, Any]:
        self._box.driver(axis).halt(at_once)
        return self._ended(axis, "stopped by the host")

    def wait(self, seconds: float) -> dict[str, Any]:
        self._box.stage.run(seconds)
        return {"waited_s": seconds, "time_s": round(self._box.stage.time, 9)}

    def wait_until_stopped(self, axis: str, timeout: float) -> dict[str, Any]:
        a, driver = self._box.axis(axis), self._box.driver(axis)
        if axis in self._watched and self._watched[axis][0].name != BY_ITSELF:
            why = driver.wait(timeout)
        else:
            wait_until_stopped([a], timeout)
            why = self._status(axis)
        a.wait(SETTLE)
        return self._ended(axis, why, self._stops.pop(axis, ""))

    def report(self) -> dict[str, Any]:
        last = self._box.report
        if last is None:
            raise StageError("there is no report yet: move, home, line or start with wait_until_stopped make one.")
        return told(last, self._box.mode)

    def _status(self, axis: str) -> str:
        """Why a run ended that a host began by itself, it has to read from the status."""
        places = {p.name: p for p in self._box.axis(axis).chip.MAP.places}
        words = self._box.driver(axis).status_words()
        return "; ".join(Fields(places[name]).tell(name, value) for name, value in words.items())

    # --- what happens beside them ---

    def before_write(self, chip: Chip, address: int, value: int) -> None:
        """A host writes by itself: a start that comes of it is a move, and is watched."""
        for a in self._box.stage.axes.values():
            if a.chip is chip and a.name in self._watched and a.chip.busy(a.chip_axis):
                if self._box.driver(a.name).stops(address, value):
                    self._stops[a.name] = f"stopped by the host: {value:0{chip.DATA_MASK.bit_length() // 4}X}h"
            elif a.chip is chip and chip.starts(address, value, a.chip_axis):
                self._box.meter.move()
                self._end(a.name)
                self._watch(a.name, BY_ITSELF, None)

    def drop(self) -> None:
        """Forget what is watched."""
        for name in tuple(self._watched):
            self._end(name)

    def _watch(self, axis: str, name: str, asked: int | None) -> Procedure:
        self._stops.pop(axis, None)
        watched = Procedure(self._box.axis(axis), name).__enter__()
        self._watched[axis] = watched, asked
        return watched

    def _end(self, axis: str) -> None:
        if axis in self._watched:
            self._watched.pop(axis)[0].__exit__(None, None, None)

    def _at_rest(self, axis: str) -> None:
        a = self._box.axis(axis)
        if a.chip.twin().busy(a.chip_axis):  # the driver would ask by a bus cycle
            raise ArgumentError(f"axis {axis} is moving: wait_until_stopped waits for its end, and stop stops it.")

    def _ended(self, axis: str, why: str, by_host: str = "") -> dict[str, Any]:
        if axis not in self._watched:
            return {"axis": axis, "at_rest": True, "time_s": round(self._box.stage.time, 9)}
        watched, asked = self._watched.pop(axis)
        report = watched.report(why, asked)
        if by_host and report.pulses != asked:  # the status has no bit for it, and a driver guesses from what is left
            report = replace(report, stopped_by=by_host)
        return self._done(report, axis)

    def _asked(self, axis: str, given: dict[str, Any]) -> tuple[int, Any]:
        distance, pulses = given.get("distance"), given.get("pulses")
        if (distance is None) == (pulses is None):
            raise ArgumentError('give distance ("10mm", or in m) or pulses, one of the two.')
        a = self._box.axis(axis)
        wanted = procedures.pulses_of(a, distance, pulses)
        if not wanted:
            raise ArgumentError(
                f"no pulse: a pulse of axis {axis} is {a.meters_per_pulse:g} {a.unit}; ask for one at least."
            )
        return wanted, self._speeds(axis, given)

    def _speeds(self, axis: str, given: dict[str, Any]) -> Any:
        names = ("speed", "start_speed")
        one, other = (given.get(n) for n in names)
        per_pulse, unit = self._box.axis(axis).meters_per_pulse, self._box.axis(axis).unit
        for name, speed in zip(names, (one, other), strict=True):
            if speed is not None and speed < SLOWEST * per_pulse:
                least = SLOWEST * per_pulse
                raise ArgumentError(
                    f"{name}: {speed:g} is too slow; from {least:g} {unit}/s on, {SLOWEST:g} pulses a second."
                )
        accel, decel = given.get("accel", RAMP), given.get("decel")
        return procedures.speeds(self._box.axis(axis), one, other, accel, decel, bool(given.get("s_curve")))

    def _square(self, axis: str, direction: str, by: str | None, given: dict[str, Any]) -> dict[str, Any]:
        """Home of axes that drive one load."""
        one = self._box.axis(axis)
        axes = [one, *(self._box.axis(name) for name in one.tandem)]
        if by is not None:
            raise ArgumentError(f"by={by!r}: axis {axis} drives one load with {', '.join(one.tandem)}; leave it out.")
        for a in axes:
            self._at_rest(a.name)
            self._end(a.name)
        reports = square_by(axes, WAYS.index(direction) * 2 - 1, self._speeds(axis, given), given.get("timeout", 60.0))
        told_of = {r.axis: self._done(r, r.axis) for r in reports}
        return {"procedure": "home of axes that drive one load", "axes": told_of}

    def _done(self, report: Any, what: str) -> dict[str, Any]:
        self._box.report = report
        return told(report, self._box.mode)


def told(report: Report | SynchronizedReport, mode: str) -> dict[str, Any]:
    """A report as an agent of this mode may see it.

    Host: what it asked for, the pulses by the chip's counters, the time from the start to the interrupt at the stop, and why it
    stopped, as far as registers tell. Truth: also where the carriage is, steps lost, and the rates that were made.
    """
    if isinstance(report, SynchronizedReport):
        axes = {name: told(r, mode) for name, r in report.axes.items()}
        made: dict[str, Any] = {
            "procedure": "line",
            "as_asked": all(a["as_asked"] for a in axes.values()),
            "axes": axes,
        }
        if mode == "truth":
            made |= {
                "off_the_line_pulses": round(report.deviation.pulses, 3),
                "carriage_off_m": report.carriage_deviation,
            }
        return made
    done = report.asked is None or report.pulses == report.asked
    as_asked = None if report.procedure == BY_ITSELF else done and report.stopped_by not in NOT_AS_ASKED
    said: dict[str, Any] = {
        "procedure": report.procedure, "axis": report.axis, "as_asked": as_asked,
        "stopped_by": report.stopped_by, "asked_pulses": report.asked, "counted_pulses": report.pulses,
        "duration_s": round(report.duration, 9),
    }  # fmt: skip
    if report.residual is not None:
        said["R0_left"] = report.residual
    if mode == "truth":
        said |= {
            "as_asked": as_asked and report.ok, "lost_steps": report.lost_steps, "from": report.start, "to": report.position,
            "peak_rate_pps": round(report.peak_rate, 3),
        }  # fmt: skip
    return said
