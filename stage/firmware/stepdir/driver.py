"""Driver of STEP/DIR axes: it writes rates, ramps and steps to the step timer, as firmware sets up its timer interrupt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from stage.chips.journal import Journal
from stage.chips.stepdir.maps import CONTROL_ADDRESS, END_REASONS, MAP
from stage.chips.stepdir.step_timer import AT_ONCE, SLOW
from stage.errors import ArgumentError, ExceededLimit
from stage.firmware import move_plot_signals
from stage.firmware.driver import (
    SETTLING_TIME_S,
    Driver,
    ImmediateOperations,
    Speeds,
    select_moving_drivers,
    wait_until_stopped,
)
from stage.firmware.home_program import HomeProgram
from stage.firmware.line_programs import LinePrograms
from stage.firmware.move_plot_signals import BLUE, GREEN, GREY, RED
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.stepdir.home_program import OrgHomeProgram
from stage.firmware.stepdir.line_programs import BresenhamLinePrograms
from stage.firmware.stop_reasons import ANOTHER_AXIS
from stage.firmware.synchronized_report import EarlyStopHandler, LineObserver, SynchronizedReport
from stage.sim.program import Operations

END = MAP.field("status", "end")
HALT_TIMEOUT_S = 60.0
HOME_RATE_PPS = 400.0
"""Rate of the last approach to ORG; slow, so that the motor does not ring when the switch trips."""
BACK_OFF_STEPS = 400
MAX_BACK_OFFS = 200


class StepDirPattern(move_plot_signals.OperationPattern):
    """Signals of a STEP/DIR axis that the plot of a report shows."""

    LANES = (
        ("up", "UP", BLUE), ("down", "DOWN", BLUE), ("busy", "BUSY", GREY), ("dir", "DIR", GREY), ("org", "ORG", GREEN),
        ("el_plus", "EL+", RED), ("el_minus", "EL-", RED),
    )  # fmt: skip
    ALWAYS = ("up", "down", "busy")


class StepDirDriver(Driver):
    """Driver of one STEP/DIR axis."""

    PATTERN_CLASS: ClassVar = StepDirPattern
    DONE_REASON: ClassVar = END_REASONS[1]
    HOME_REASONS: ClassVar = ("ORG",)
    HOMING_METHODS: ClassVar = ("switch",)
    INDEX_PULSES: ClassVar = 0
    DISTANCE_REGISTER: ClassVar = "STEPS"
    OPTIONS: ClassVar = frozenset({"s_curve_share", "constant", "approach"})

    @property
    def max_rate(self) -> float:
        return float(MAP.register("RATE").range[1])

    # --- now ---

    def start(self, pulses: int, speeds: Speeds) -> None:
        if not pulses:
            raise ArgumentError("pulses=0: a move has at least one step; its sign is the direction.")
        MAP.check_value("STEPS", abs(pulses))
        self._write_registers({**self._compute_registers(speeds), "STEPS": abs(pulses), "EVENTS": 0})
        self.goal = self.chip.net() + pulses
        self._send("MOVE", pulses)

    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        with ProcedureObserver(self.axis, "move") as procedure:
            self.start(pulses, speeds)
            reason = self.wait(compute_time_limit(pulses, speeds) if timeout is None else timeout)
            self.axis.wait(SETTLING_TIME_S)
            return procedure.make_report(reason, pulses)

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        with ProcedureObserver(self.axis, "origin return") as procedure:
            self._write_registers(
                {**self._compute_registers(speeds._replace(s_curve=False)), "STEPS": BACK_OFF_STEPS, "EVENTS": 0}
            )
            reason = self._search(direction, timeout)
            if reason in ("", "ORG"):
                approach = speeds.approach if speeds.approach is not None else min(HOME_RATE_PPS, speeds.drive)
                reason = self._approach(direction, round(approach), timeout) if approach else "ORG"
            self.axis.wait(SETTLING_TIME_S)
            return procedure.make_report(reason)

    def _search(self, direction: int, timeout: float) -> str:
        """Run to ORG unless the axis is on it, and return the stop reason."""
        return "" if self._is_at_origin() else self._run_to_end("HOME", direction, timeout)

    def _approach(self, direction: int, rate: int, timeout: float) -> str:
        """Back off from ORG and approach it slowly; return the stop reason of the last run."""
        for _ in range(MAX_BACK_OFFS):
            if not self._is_at_origin():
                break
            if (reason := self._run_to_end("MOVE", -direction, timeout)) != self.DONE_REASON:
                return reason
        self._write_registers({"START": rate, "RATE": rate})
        return self._run_to_end("HOME", direction, timeout)

    def _is_at_origin(self) -> bool:
        """Return whether the status shows ORG."""
        return bool(self.chip.read(CONTROL_ADDRESS) & MAP.mask("status", "org"))

    def _run_to_end(self, command: str, direction: int, timeout: float) -> str:
        """Start a run with a command in a direction, wait for its end, and return the stop reason."""
        self._send(command, direction)
        wait_until_stopped([self.axis], timeout)
        reason = self._read_end_reason()
        self.axis.wait(SETTLING_TIME_S)
        return reason

    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        self._write_registers(self._compute_registers(speeds))
        self._send("RUN", direction)

    def slow_down(self) -> None:
        """Write the command for a stop with a ramp, and do not wait."""
        self.chip.write(CONTROL_ADDRESS, SLOW)

    def halt(self, at_once: bool = False) -> None:
        self.chip.write(CONTROL_ADDRESS, AT_ONCE if at_once else SLOW)
        wait_until_stopped([self.axis], HALT_TIMEOUT_S)

    def is_stop_command(self, address: int, value: int) -> bool:
        return address == CONTROL_ADDRESS and bool(value & (AT_ONCE | SLOW))

    def read_stop_reason(self) -> str:
        reason = self._read_end_reason()
        return reason if reason in ("EL+", "EL-", "ORG") else ""

    def _read_end_reason(self) -> str:
        """Return the stop reason that the status shows."""
        return END_REASONS[END.extract(self.chip.read(CONTROL_ADDRESS))]

    def read_register(self, name: str) -> int:
        register = MAP.register(name)
        return register.value(self.chip.read(register.number))

    def _compute_registers(self, speeds: Speeds) -> dict[str, int]:
        """Compute the registers of these speeds. Raises ArgumentError for rates that the step timer cannot make."""
        for name, field, rate in (("START", "start_speed", speeds.start), ("RATE", "speed", speeds.drive)):
            low, high = MAP.register(name).range
            if not low <= rate <= high:
                raise ArgumentError(
                    f"{field} of {rate:g} pps: the step timer makes {low:,} to {high:,} steps per second."
                ).with_limit(ExceededLimit(field, rate, low, high))
        if speeds.start > speeds.drive:
            raise ArgumentError(
                f"start speed {speeds.start:g} pps is above the drive speed {speeds.drive:g} pps: ramps lead up."
            ).with_limit(ExceededLimit("start_speed", speeds.start, 0, speeds.drive))
        start = speeds.drive if speeds.constant else speeds.start
        registers = self.compute_move_registers(start, speeds.drive, speeds.up, speeds.down, 1)
        share = 0.5 if speeds.s_curve is True else float(speeds.s_curve)
        return {**registers, "CURVED": round(100 * share)}

    def _write_registers(self, values: Mapping[str, int]) -> None:
        """Write registers by name. Raises StageError if the axis moves."""
        if self.chip.busy():
            raise self.build_moving_error()
        self.prepare()
        now = ImmediateOperations(self.axis)
        for name, value in values.items():
            now.register(self.index, self.chip, name, value)

    def _send(self, command: str, direction: int) -> None:
        """Write a command for a direction to the command register."""
        self.chip.write(CONTROL_ADDRESS, encode_command(command, direction))

    @classmethod
    def move_line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """Move along a line: the steps of the shorter axes are spread among those of the longest by Bresenham's rule."""
        moving: dict[str, Any] = select_moving_drivers(drivers, pulses)
        events = max(abs(pulses[name]) for name in moving)
        MAP.check_value("STEPS", events)
        procedures = {name: ProcedureObserver(driver.axis, "line") for name, driver in moving.items()}
        with LineObserver(procedures, {name: pulses[name] for name in moving}) as observer:
            for name, driver in moving.items():
                driver._write_registers(
                    {**driver._compute_registers(speeds), "STEPS": abs(pulses[name]), "EVENTS": events}
                )
            for name, driver in moving.items():
                driver._send("MOVE", pulses[name])
                observer.note_start(name)
            early_stop = EarlyStopHandler(observer, moving)
            axes = [driver.axis for driver in moving.values()]
            with observer.attach_reports_to_timeout():
                limit_s = compute_time_limit(events, speeds) if timeout is None else timeout
                wait_until_stopped(axes, limit_s, on_poll=early_stop)
            axes[0].wait(SETTLING_TIME_S)
            reasons = {
                name: ANOTHER_AXIS if name in early_stop.stopped else driver._read_end_reason()
                for name, driver in moving.items()
            }
            return observer.make_report(reasons)

    def explain_end(self, all_pulses_sent: bool, journal: Journal | None = None) -> str:
        return self._read_end_reason()

    # --- as programs ---

    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        return ("START", "RATE", "UP", "DOWN", *(("CURVED",) if s_curve else ()))

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        values = {"START": fl, "RATE": fh, "UP": 1e6 * up, "DOWN": 1e6 * down, **({"CURVED": 50.0} if s_curve else {})}
        ranges = {name: MAP.register(name).range for name in values}
        return {name: min(max(round(value), ranges[name][0]), ranges[name][1]) for name, value in values.items()}

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        for name, value in {**values, "STEPS": abs(pulses)}.items():
            program.register(self.index, self.chip, name, value)
        program.command(self.index, encode_command("MOVE", pulses))

    def write_stop(self, program: Operations) -> None:
        program.command(self.index, AT_ONCE)

    def build_home_program(self, settings: Any) -> HomeProgram:
        return OrgHomeProgram(self, settings)

    def build_line_programs(self, drivers: Sequence[Driver], settings: Any) -> LinePrograms:
        return BresenhamLinePrograms(drivers, settings)


def encode_command(command: str, direction: int) -> int:
    """Return the code of a command of the step timer: "MOVE", "RUN" or "HOME" in the direction of a sign."""
    return MAP.command(f"{command}{'+' if direction > 0 else '-'}").code


def compute_time_limit(pulses: int, speeds: Speeds) -> float:
    """Estimate a generous time for a move: half as much again as it takes at the slower of its rates, and one second."""
    slowest = max(1.0, min(speeds.start or speeds.drive, speeds.drive))
    return 1.5 * abs(pulses) / slowest + 3.0 * (speeds.up + speeds.down) + 1.0
