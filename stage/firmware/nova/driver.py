"""Drivers of the NOVA chips, which have several axes, words of 16 bits, and commands for drives and a home search."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar, cast

import numpy as np

from stage.chips.journal import Journal
from stage.errors import ArgumentError, ExceededLimit, add_article
from stage.firmware import move_plot_signals
from stage.firmware.axis import has_positive_logic
from stage.firmware.driver import (
    SETTLING_TIME_S,
    Driver,
    ImmediateOperations,
    Speeds,
    select_moving_drivers,
    wait_until_stopped,
)
from stage.firmware.home_program import HomeProgram
from stage.firmware.line_programs import LineMoves, LinePrograms, LineSettings, create_line_programs
from stage.firmware.move_plot_signals import AMBER, BLUE, GREEN, GREY, RED, VIOLET
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.nova.chip_port import ChipPort
from stage.firmware.nova.home_program import HomeSearchProgram
from stage.firmware.nova.line_programs import InterpolatedLinePrograms, NovaLinePrograms, RangeRatioLinePrograms
from stage.firmware.parameter_ranges import get_register_range
from stage.firmware.stop_reasons import ANOTHER_AXIS, UNKNOWN, UNWANTED_REASONS
from stage.firmware.synchronized_report import EarlyStopHandler, LineObserver, SynchronizedReport
from stage.sim.program import Operations, Program

OperationsType = TypeVar("OperationsType", bound=Operations)

SEARCH_TIME_FACTOR = 3  # runs that an automatic search stands for: so many times `limit` it may take
HOME_SPEED_PPS = 400.0  # pps; slow, so that the motor does not ring when the switch trips
STOP_TIMEOUT_S = 60.0  # s for a stop
STOP_REASON_BY_BIT = {
    "LMT+": "EL+", "LMT-": "EL-", "STOP1": "ORG", "STOP2": "EZ", "STOP0": "STOP0", "STOP3": "STOP3", "EMG": "EMG",
    "ALARM": "ALARM", "SYNC": "SYNC",
}  # fmt: skip
"""Name of a bit that shows the end of a drive -> stop reason in reports."""


def _check_start_speed(speeds: Speeds, low: float = 0.0) -> None:
    """Raise ArgumentError if the start speed is above the drive speed. `low` is the lowest speed of the chip, pps."""
    if speeds.start > speeds.drive:
        raise ArgumentError(
            f"start speed {speeds.start:g} pps is above the drive speed {speeds.drive:g}: ramps lead up."
        ).with_limit(ExceededLimit("start_speed", speeds.start, low, speeds.drive))


class NovaPattern(move_plot_signals.OperationPattern):
    """Signals and commands of a NOVA chip that the plot of a report shows."""

    LANES = (
        ("asnd", "ASND", BLUE), ("cnst", "CNST", BLUE), ("dsnd", "DSND", BLUE), ("drive", "n-DRV", GREY),
        ("dir", "DIR \N{MINUS SIGN}", VIOLET), ("stop0", "STOP0", AMBER), ("stop1", "ORG", GREEN), ("stop2", "EZ", GREEN),
        ("lmt_plus", "EL+", RED), ("lmt_minus", "EL-", RED), ("alarm", "ALARM", RED),
    )  # fmt: skip
    ALWAYS = ("asnd", "cnst", "dsnd", "drive")

    def needs_annotation(self, meaning: str) -> bool:
        return "driv" in meaning or "stop" in meaning or "home" in meaning or "interpolation" in meaning


class NovaDriver(Driver):
    """Base class of the host drivers of NOVA chips.

    Attributes:
        SPEEDS: Names of the registers of initial speed, drive speed and acceleration.
        JERK: Name of the register of the jerk.
    """

    PATTERN_CLASS: ClassVar = NovaPattern
    INVERTIBLE_SENSORS: ClassVar = ("org", "ez", "el_plus", "el_minus")
    SPEEDS: ClassVar[tuple[str, str, str]]
    JERK: ClassVar[str]
    UNIT: ClassVar[int] = 1
    """pps of a unit of speed, as `add_drive_modes` sets it."""
    NOP: ClassVar[str] = "NOP"
    STOP: ClassVar[str]
    SLOW_DOWN: ClassVar[str]
    RUN: ClassVar[tuple[str, str]]
    """Continuous drives, plus and minus."""
    END_WORD: ClassVar[str]
    """Status word whose bits show what has ended a drive."""

    def __init__(self, axis: Any):
        super().__init__(axis)
        self.map = self.chip.MAP
        self.port = ChipPort(axis)
        self.bit = self.port.bit

    @property
    def max_rate(self) -> float:
        return float(get_register_range(self.map, self.SPEEDS[1])[1] * self.UNIT)

    # --- now ---

    def start(self, pulses: int, speeds: Speeds) -> None:
        if not pulses:
            raise ArgumentError("pulses=0: a drive has at least one; its sign is the direction.")
        self.map.check_value(self.DISTANCE_REGISTER, pulses if self.SIGNED else abs(pulses))
        self._write_modes_and_registers(self._compute_registers(speeds, abs(pulses)))
        self.goal = self.chip.net(self.axis.chip_axis) + pulses
        self.add_drive(ImmediateOperations(self.axis), pulses)

    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        with ProcedureObserver(self.axis, "move") as observer:
            self.start(pulses, speeds)
            slowest = min(speeds.start, speeds.drive)
            max_seconds = 1.5 * abs(pulses) / slowest + 3 * (speeds.up + speeds.down) + 1
            wait_until_stopped([self.axis], max_seconds if timeout is None else timeout)
            self.axis.wait(SETTLING_TIME_S)
            reasons = self.explain_end(observer.pulses_made == pulses, observer.journal)
            # a drive that nothing has stopped made the pulses that it was told: others than asked, where a write was lost
            return observer.make_report(self.DONE_REASON if reasons == UNKNOWN else reasons, pulses)

    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        self._write_modes_and_registers(self._compute_registers(speeds._replace(s_curve=False), 1))
        self.port.write_command(self.RUN[direction < 0])

    def slow_down(self) -> None:
        """Command a decelerating stop of the axis, and do not wait for its end."""
        self.port.write_command(self.SLOW_DOWN)

    def halt(self, at_once: bool = False) -> None:
        if self.port.is_driving():
            self.port.write_command(self.STOP if at_once else self.SLOW_DOWN)
        wait_until_stopped([self.axis], STOP_TIMEOUT_S)

    def is_stop_command(self, address: int, value: int) -> bool:
        codes = self.map.command_codes(self.STOP, self.SLOW_DOWN)
        return address == 0 and bool(value >> 8 & 1 << self.axis.chip_axis) and value & 0xFF in codes

    def read_stop_reason(self) -> str:
        word = self.port.read_status_register(int(self.END_WORD[2]))
        return next((name for bit, name in STOP_REASON_BY_BIT.items() if word & self._get_end_mask(bit)), "")

    def explain_end(self, all_pulses_sent: bool, journal: Journal | None = None) -> str:
        """Return the stop reason of a drive. END_WORD has no bit for software limits, so they are read from RR2.

        Args:
            all_pulses_sent: Whether the chip has made every pulse.
            journal: Journal of the chip, opened before the drive.
        """
        reasons = super().explain_end(all_pulses_sent, journal)
        return reasons if reasons != UNKNOWN else next(iter(self.port.read_error_names()), UNKNOWN)

    def read_status_words(self) -> dict[str, int]:
        """Read RR0 to RR2, and the input signals RR4 and RR5 where the chip has them. Reading RR3 would clear it."""
        self.port.write_command(self.NOP)
        names = {w.name: w for w in self.map.words}
        return {
            n: self.chip.read(int(n[2:])) for n in ("RR0", "RR1", "RR2", "RR4", "RR5") if n in names and names[n].fields
        }

    def read_register(self, name: str) -> int:
        r = self.map.register(name)
        for symbol in (f"R-{r.name}", r.name):
            if any(c.symbol == symbol and c.kind == "data read" for c in self.map.commands):
                return r.value(self.port.read_value(symbol))
        raise self.build_unreadable_register_error(r.name)

    def _get_end_mask(self, bit: str) -> int:
        """Return the mask of a stop cause in END_WORD (on an MCX514 END-EMG, END-ALARM); 0 if the chip has no such bit."""
        names = {f.name for f in self.map.word(self.END_WORD).fields}
        name = f"END-{bit}" if f"END-{bit}" in names else bit
        return self.map.mask(self.END_WORD, name) if name in names else 0

    def _compute_registers(self, speeds: Speeds, pulses: int) -> dict[str, int]:
        """Compute the registers of these speeds. Raises ArgumentError for speeds that the chip cannot make."""
        low, high = (limit * self.UNIT for limit in get_register_range(self.map, self.SPEEDS[1]))
        for name, field, rate in (("start", "start_speed", speeds.start), ("drive", "speed", speeds.drive)):
            if not low <= rate <= high:
                raise ArgumentError(
                    f"{name} speed {rate:g} pps: {add_article(self.map.chip)} makes {low:g} to {high:g} pps here."
                ).with_limit(ExceededLimit(field, rate, low, high))
        _check_start_speed(speeds, low)
        return self.compute_move_registers(
            speeds.start, speeds.drive, speeds.up, speeds.down, pulses, bool(speeds.s_curve)
        )

    def _write_modes_and_registers(self, registers: Mapping[str, int]) -> None:
        """Write the drive modes and the speed registers. Raises StageError if the axis moves."""
        if self.port.is_driving():
            raise self.build_moving_error()
        now = ImmediateOperations(self.axis)
        self.add_drive_modes(now, self.JERK in registers)
        for name, value in registers.items():
            self.add_register_write(now, name, value)
        self.add_end_status_clear(now)

    @classmethod
    def move_line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """Move along a line by the chip's linear interpolation if it has one, otherwise by ranges in the ratio of the distances."""
        moving_drivers = select_moving_drivers(cast("dict[str, NovaDriver]", drivers), pulses)
        for driver in moving_drivers.values():
            if driver.port.is_driving():
                raise driver.build_moving_error()
        settings = LineSettings(
            speeds.start, max(speeds.up, speeds.down), bool(speeds.s_curve), axes=tuple(moving_drivers)
        )
        line_plan = cast(NovaLinePrograms, create_line_programs(list(moving_drivers.values()), settings))
        for n, driver in moving_drivers.items():
            line_plan.check_pulses(driver, pulses[n])
        if speeds.drive > line_plan.max_rate:
            raise ArgumentError(f"drive speed {speeds.drive:g} pps: up to {line_plan.max_rate:g} pps here.").with_limit(
                ExceededLimit("speed", speeds.drive, 0.0, line_plan.max_rate)
            )
        _check_start_speed(speeds)
        distances = np.array([[pulses[n] for n in moving_drivers]])
        moves = LineMoves(distances, np.array([speeds.drive]))
        ops = line_plan.write_programs(line_plan.compute_registers(moves), moves)[0]
        axes = [d.axis for d in moving_drivers.values()]
        now = ImmediateOperations(*axes)
        with LineObserver(
            {n: ProcedureObserver(d.axis, "line") for n, d in moving_drivers.items()},
            {n: pulses[n] for n in moving_drivers},
        ) as together:
            for d in moving_drivers.values():
                d.add_end_status_clear(now)
            starts = line_plan.find_start_operations(distances[0]).tolist()
            for j, (_, index, address, value) in enumerate(ops.tolist()):
                now.write(index, address, value)
                if j in starts:
                    together.note_start(*(n for n, at in zip(moving_drivers, starts, strict=True) if at == j))
            max_pulses = float(moves.longest[0])
            max_seconds = 1.5 * max_pulses / min(speeds.start, speeds.drive) + 6 * settings.accel + 1
            # a chip ends its own
            breaker = EarlyStopHandler(
                together, {} if isinstance(line_plan, InterpolatedLinePrograms) else moving_drivers
            )
            with together.attach_reports_to_timeout():
                wait_until_stopped(axes, max_seconds if timeout is None else timeout, on_poll=breaker)
            axes[0].wait(SETTLING_TIME_S)
            reasons = {
                n: d.explain_end(together.has_arrived(n), together.watch[n].journal) for n, d in moving_drivers.items()
            }
            if any(
                why in UNWANTED_REASONS and why != UNKNOWN for why in reasons.values()
            ):  # it has ended the interpolation
                reasons = {
                    n: ANOTHER_AXIS if why == UNKNOWN or n in breaker.stopped else why for n, why in reasons.items()
                }
            return together.make_report(reasons)

    # --- as operations ---

    def add_command(self, program: OperationsType, symbol: str) -> OperationsType:
        """Add a command for this axis, or for the whole chip if the command has no axis bits.

        Args:
            program: Program, or operations that are done at once.
            symbol: Symbol of the command in the chip's map.
        """
        c = self.map.command(symbol)
        return program.write(self.index, 0, (self.bit << 8 if c.axes else 0) | c.code)

    def add_register_write(self, program: OperationsType, name: str, value: int) -> OperationsType:
        """Add the write of a parameter or mode register, of this axis or of the whole chip, to a program.

        Args:
            program: Program, or operations that are done at once.
            name: Name of the parameter or mode in the chip's map.
            value: Value to write.
        """
        return program.register(self.index, self.chip, name, value, self.axis.chip_axis)

    def add_mode_words(self, program: OperationsType, **words: int) -> OperationsType:
        """Add the writes of the mode words WR1 to WR3 of this axis to a program.

        Args:
            program: Program, or operations that are done at once.
            words: Values by the names of the words.
        """
        self.add_command(program, self.NOP)
        for name, value in words.items():
            program.write(self.index, int(name[2:]), value)
        return program

    def get_mask(self, word: str, *names: str) -> int:
        """Return the mask of named bits in a word of the chip's map."""
        return sum(self.map.masks(word, *names))

    @abstractmethod
    def add_drive_modes(self, program: OperationsType, s_curve: bool = False) -> OperationsType:
        """Add the modes of a drive after power-up: ramps, and end limits that stop it.

        Args:
            program: Program, or operations that are done at once.
            s_curve: Whether the ramps are S-curves.
        """

    @abstractmethod
    def add_drive(self, program: OperationsType, pulses: int) -> OperationsType:
        """Add the pulses and the start of a fixed-pulse drive to a program.

        Args:
            program: Program, or operations that are done at once.
            pulses: Signed pulses of the drive.
        """

    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        return (*self.SPEEDS, self.JERK) if s_curve else self.SPEEDS

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        self.add_drive_modes(program, s_curve=self.JERK in values)
        for name, value in values.items():
            self.add_register_write(program, name, value)
        self.add_drive(program, pulses)

    def write_stop(self, program: Operations) -> None:
        self.add_command(program, self.STOP)

    def clip_to_legal_range(self, name: str, value: float) -> int:
        """Return the nearest value of a register that the data sheet allows."""
        low, high = get_register_range(self.map, name)
        return int(np.clip(round(value), low, high))

    def build_home_program(self, settings: Any) -> HomeProgram:
        return HomeSearchProgram(self, settings)

    # --- lines ---

    SIGNED: ClassVar[bool]
    """FINISH, the register of the finish point, has a sign, which is the direction."""

    def build_line_programs(self, drivers: Sequence[Driver], settings: Any) -> LinePrograms:
        """Build lines by interpolation if the chip can interpolate all axes, otherwise by speeds in the ratio of the distances."""
        if self.can_interpolate(cast(Any, drivers)):
            return InterpolatedLinePrograms(cast(Any, drivers), settings)
        return RangeRatioLinePrograms(cast(Any, drivers), settings)

    @abstractmethod
    def can_interpolate(self, drivers: Sequence[NovaDriver]) -> bool:
        """Return whether one chip, or several linked ones, can interpolate the axes of these drivers.

        Args:
            drivers: Drivers of the axes.

        Raises:
            ArgumentError: The chips can make the line neither by interpolation nor in another way.
        """

    @abstractmethod
    def add_interpolation(self, program: OperationsType, drivers: Sequence[NovaDriver]) -> OperationsType:
        """Add the bus cycles that select the axes, enable deceleration, and start linear interpolation to finish points set before.

        Args:
            program: Program, or operations that are done at once.
            drivers: Drivers of the axes.
        """

    # --- the home search ---

    @abstractmethod
    def add_home_search(
        self, program: Program, fast: bool, timer: int, index: bool, timeout_s: float, rest_s: float
    ) -> list[int]:
        """Add a search for ORG, the origin switch, towards minus to a program.

        Args:
            program: Program, or operations that are done at once.
            fast: True to begin at the drive speed; False to begin at HV.
            timer: Code of the rest between steps; 0: none.
            index: True to go on to STOP2, the index pulse.
            timeout_s: Time that a drive may take, s.
            rest_s: Time to wait after the stop, s.

        Returns:
            Indices of the operations that poll for the stop.
        """

    def add_input_level_reads(self, program: Program) -> dict[str, tuple[int, int, bool]]:
        """Add the reads of the errors and of the levels of STOP1 and STOP2 to a program.

        Args:
            program: Program that gets the reads.

        Returns:
            For "error", "stop1" and "stop2": index of the read operation, mask, and the level that means on.
        """
        self.add_command(program, self.NOP)
        at = len(program)
        program.read(self.index, 2).read(self.index, self.find_stop_level_mask(1)[0])
        levels = {
            f"stop{k}": (at + 1, self.find_stop_level_mask(k)[1], self.is_stop_input_active_high(k)) for k in (1, 2)
        }
        # HLMT+: on its way out of an ORG that is stuck
        return {"error": (at, self.get_mask("RR2", "HOME", "HLMT+"), True), **levels}

    @abstractmethod
    def find_stop_level_mask(self, number: int) -> tuple[int, int]:
        """Find the bit that has the level of the input STOP1 or STOP2 of this axis.

        Args:
            number: 1 or 2.

        Returns:
            Bus address of the register, and mask of the bit.
        """

    def is_stop_input_active_high(self, number: int) -> bool:
        """Return whether STOP1 (ORG) or STOP2 (EZ) is high while it is on; `number` is 1 or 2."""
        return has_positive_logic(self.axis, ("org", "ez")[number - 1])

    @abstractmethod
    def add_end_status_clear(self, program: OperationsType) -> OperationsType:
        """Add the command that clears the end status of earlier drives, if the chip has one."""

    @abstractmethod
    def get_home_search_ranges(self) -> dict[str, tuple[int, int]]:
        """Return the ranges of the choices (parameters) of a home search by name, except the speeds and `leave`."""
