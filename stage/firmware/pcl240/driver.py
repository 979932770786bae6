"""Driver of the PCL-240 family, which has a chip for each axis and registers of bytes.

Its moves are those of moves.py, origin_return.py and synchronized_move.py.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, cast

from stage.chips.journal import Journal
from stage.firmware.driver import DUAL_RATE_ORDER, Driver, Speeds
from stage.firmware.home_program import HomeProgram
from stage.firmware.move_report import Report
from stage.firmware.pcl240 import chip_port, moves
from stage.firmware.pcl240.chip_port import ChipPort, require_clock
from stage.firmware.pcl240.home_program import FourRunHomeProgram
from stage.firmware.pcl240.line_programs import RatioLinePrograms
from stage.firmware.pcl240.move_plot_signals import Pcl240Pattern
from stage.firmware.pcl240.origin_return import APPROACH_RATE_PPS, origin_return
from stage.firmware.pcl240.procedure_observer import find_present_stop_reason, find_stop_reason
from stage.firmware.pcl240.rate_change_moves import dual_rate_move
from stage.firmware.pcl240.speed_profile import MAX_SPEED_STEPS, Profile, compute_pulse_rate, get_default_second_rate
from stage.firmware.pcl240.synchronized_move import synchronized_move
from stage.firmware.synchronized_report import SynchronizedReport
from stage.sim.program import Operations

TUNED_REGISTERS = ("R1", "R2", "R4", "R5", "R6", "R7")
S_CURVE_REGISTERS = ("R14", "R15")


class Pcl240Driver(Driver):
    """Driver of PCL-240K, PCL-240MK and PCL-240MS."""

    PATTERN_CLASS: ClassVar = Pcl240Pattern
    DONE_REASON: ClassVar = "R0 = 0"
    DISTANCE_REGISTER: ClassVar = "R0"
    INVERTIBLE_SENSORS: ClassVar = ("org", "ez", "el_plus", "el_minus", "sd_plus", "sd_minus")
    TRIM_FACTORS: ClassVar = {"R6": 1.06}  # the formula leaves pulses at FL
    OPTIONS: ClassVar = frozenset({"second", "constant", "automatic", "approach", "s_curve_share"})
    INDEX_PULSES: ClassVar = 16
    chip: Any

    def __init__(self, axis: Any):
        super().__init__(axis)
        self.port = ChipPort(axis)
        self._journal: Journal | None = None
        self._close = weakref.finalize(self, lambda: None)

    @property
    def max_rate(self) -> float:
        return compute_pulse_rate(
            MAX_SPEED_STEPS, require_clock(self.axis) or chip_port.MIN_MULTIPLIER, self.chip.clock_hz
        )

    @property
    def position_counter(self) -> str:
        """R10, the position counter of an MK or MS; "" for the K, which has none."""
        return "R10" if self.chip.EXTENDED else ""

    def peek_position_counter(self) -> int | None:
        return self._sign_counter(self.chip.values()["R10"]) if self.position_counter else None

    def get_default_second_rate(self, drive: float) -> float:
        return get_default_second_rate(drive, self.chip.clock_hz, require_clock(self.axis))

    def describe_speeds(self, speeds: Speeds) -> str:
        return str(self.build_profile(speeds))

    def build_profile(self, speeds: Speeds) -> Profile:
        """Build the speed profile of these speeds: FH1 is the drive speed, FH2 the second drive speed.

        Without a second drive speed, FH2 is the drive speed, too.
        """
        result = Profile.of(
            speeds.start,
            speeds.drive,
            speeds.drive if speeds.second is None else speeds.second,
            accel=speeds.up,
            decel=speeds.down,
            clock_hz=self.chip.clock_hz,
            chip=type(self.chip),
            multiplier=require_clock(self.axis),
        )
        return result.with_ramp_shape(speeds.s_curve) if speeds.s_curve else result

    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        """Make a preset move, see `preset_move`."""
        self._close_journal()
        return moves.preset_move(
            self.axis, pulses, self.build_profile(speeds), high_speed=not speeds.constant, automatic=speeds.automatic,
            timeout=timeout,
        )  # fmt: skip

    def start(self, pulses: int, speeds: Speeds) -> None:
        self._open_journal()
        self.goal = self.chip.net() + pulses
        moves.start_preset_move(self.port, self.build_profile(speeds), pulses)

    def move_at_two_rates(
        self, pulses: int, speeds: Speeds, dwell: float, rates: Sequence[str] = DUAL_RATE_ORDER
    ) -> Report:
        """Make a dual-rate move, see `dual_rate_move`."""
        self._close_journal()
        return dual_rate_move(self.axis, pulses, self.build_profile(speeds), rates=rates, dwell=dwell)

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        """Return to the mechanical origin, see `origin_return`."""
        self._close_journal()
        return origin_return(
            self.axis, direction, self.build_profile(speeds), high_speed=not speeds.constant, slow_approach=speeds.approach != 0,
            approach=speeds.approach or APPROACH_RATE_PPS, ez=index or None, timeout=timeout,
        )  # fmt: skip

    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        self._open_journal()
        moves.write_move_setup(self.port, self.build_profile(speeds), chip_port.MINUS if direction < 0 else 0)
        self.port.write_command(chip_port.RAMP_START_COMMANDS["FH1"])

    def halt(self, at_once: bool = False) -> None:
        if self.port.read_status().operating:
            self.port.write_command(chip_port.RESET if at_once else chip_port.SLOW_DOWN["FH1"])
        self.port.wait_until_stopped(60.0)
        self.port.write_command(chip_port.RESET)

    def is_stop_command(self, address: int, value: int) -> bool:
        return address == 0 and value >> 6 == 0 and bool(value & chip_port.RESET)

    def _close_journal(self) -> None:
        """Close the journal of the move that this driver has started, if it is open."""
        self._close()
        self._journal = None

    def _open_journal(self) -> None:
        """Open a journal of the chip to find out later what has ended the move. It closes with the move or with this driver."""
        self._close_journal()
        self._journal = self.chip.journal()
        self._close = weakref.finalize(self, self._journal.close)

    def read_stop_reason(self) -> str:
        """Return the stop reason of the move that this driver has started, a stop command included; "" while the axis moves.

        If another host has started the move, or there was none, the result is what would stop the chip now.
        """
        if self.port.read_status().operating:
            return ""
        self._close()
        return (
            find_stop_reason(self._journal) if self._journal is not None else find_present_stop_reason(self.chip.state)
        )

    def read_register(self, name: str) -> int:
        r = self.chip.MAP.register(name)
        if r.name == "R0":
            return self.port.read_counter()
        if not self.port.extended:
            raise self.build_unreadable_register_error(r.name)
        return r.value(self.port.read_register(r.name))

    @classmethod
    def move_line(
        cls, drivers: Mapping[str, Driver], pulses: Mapping[str, int], speeds: Speeds, timeout: float | None = None
    ) -> SynchronizedReport:
        """Move axes along a straight line with rates in the ratio of the distances, see `synchronized_move`."""
        axes = {name: driver.axis for name, driver in drivers.items()}
        for driver in drivers.values():
            cast("Pcl240Driver", driver)._close_journal()
        return synchronized_move(
            dict(pulses), axes, rate=speeds.drive, fl=speeds.start, accel=speeds.up, decel=speeds.down,
            s_curve=speeds.s_curve, automatic=speeds.automatic, timeout=timeout,
        )  # fmt: skip

    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        if s_curve and not self.chip.S_CURVES:
            raise self.build_s_curve_error()
        return TUNED_REGISTERS + (S_CURVE_REGISTERS if self.chip.S_CURVES and s_curve is not False else ())

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        a, chip = self.index, self.chip
        program.command(a, chip_port.RESET)
        if chip.S_CURVES and "R14" not in values:
            values = {**values, "R14": chip.LINEAR_RAMPS}
        for name, value in {**values, "R0": abs(pulses)}.items():
            program.register(a, chip, name, value)
        minus = chip_port.MINUS if pulses < 0 else 0
        program.command(a, chip_port.OUTPUT).command(a, chip_port.CONTROL | chip_port.PRESET | minus).command(
            a, chip_port.RAMP_START_COMMANDS["FH1"]
        )

    def write_stop(self, program: Operations) -> None:
        program.command(self.index, chip_port.RESET)

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        p = Profile.of(fl, fh, fh, accel=up, decel=down, clock_hz=self.chip.clock_hz)
        result = {**p.registers(), "R6": p.compute_ramp_down_point(pulses)}
        curved = [name for name in S_CURVE_REGISTERS if name in self.list_move_registers(s_curve)]
        return {**result, **dict.fromkeys(curved, 0)}  # curved throughout

    def build_home_program(self, settings: Any) -> HomeProgram:
        return FourRunHomeProgram(self, settings)

    def build_line_programs(self, drivers: Sequence[Driver], settings: Any) -> RatioLinePrograms:
        return RatioLinePrograms(cast(Any, drivers), settings)
