"""The MCX514's driver: registers of 32 bits in pps, a home search in four steps with timers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from stage.errors import ArgumentError
from stage.firmware.driver import SETTLING_TIME_S, Driver, Speeds
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.nova.chip_port import compute_mcx514_wr2
from stage.firmware.nova.driver import (
    HOME_SPEED_PPS,
    SEARCH_TIME_FACTOR,
    STOP_REASON_BY_BIT,
    NovaDriver,
    OperationsType,
)
from stage.firmware.nova.home_search import home_search
from stage.firmware.nova.path_interpolation import ArcSegment, PathReport, PathSpeed, move_along_path
from stage.firmware.parameter_ranges import get_register_range
from stage.sim.program import Program

MAX_TIMER_CODES = 8  # HTM
MASTER, SLAVE = 1, 2  # MLT


class Mcx514Driver(NovaDriver):
    """Driver of the MCX514."""

    SPEEDS: ClassVar = ("SV", "DV", "AC")
    JERK: ClassVar = "JK"
    DISTANCE_REGISTER: ClassVar = "TP"
    SIGNED: ClassVar = True
    STOP: ClassVar = "DRVFBRK"
    SLOW_DOWN: ClassVar = "DRVSBRK"
    RUN: ClassVar = ("DRVVP", "DRVVM")
    END_WORD: ClassVar = "RR2"

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        registers = self._compute_registers(speeds._replace(s_curve=False), 1)
        with ProcedureObserver(self.axis, "origin return") as observer:
            search_report = home_search(
                self.axis, direction=direction, speed=registers["DV"], home_speed=round(HOME_SPEED_PPS),
                initial_speed=registers["SV"], acceleration=registers["AC"], index=bool(index), timeout=timeout,
                back=False,
            )[self.axis.name]  # fmt: skip
            self.axis.wait(SETTLING_TIME_S)
            errors = [STOP_REASON_BY_BIT.get(name.removeprefix("H"), name) for name in search_report.errors]
            return observer.make_report(next(iter(errors), self.read_stop_reason() or "HOME"))

    def draw_circle(self, other: Driver, radius: int, speeds: Speeds) -> PathReport:
        registers = self._compute_registers(speeds._replace(s_curve=False), 1)
        own_axes, others = self.axis.chip_axis, other.axis.chip_axis
        centre = (0, radius) if own_axes < others else (radius, 0)  # in the order of the chip's axes
        speed = PathSpeed(registers["DV"], registers["SV"], registers["AC"])
        return move_along_path([ArcSegment(centre=centre)], self.axis, other.axis, speed=speed)

    def add_end_status_clear(self, program: OperationsType) -> OperationsType:
        return self.add_command(program, "R2CLR")

    def add_drive_modes(self, program: OperationsType, s_curve: bool = False) -> OperationsType:
        return self.add_mode_words(
            program, WR2=compute_mcx514_wr2(self.axis), WR3=self.get_mask("WR3", "SACC") if s_curve else 0
        )

    def add_drive(self, program: OperationsType, pulses: int) -> OperationsType:
        return self.add_command(self.add_register_write(program, "TP", pulses), "DRVRL")

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """Compute AC = (DV - SV) / ta (appendix A-1) and JK = 4 (DV - SV) / ta^2 (A-2).

        The longer ramp time counts for both ramps.
        """
        seconds = max(up, down)
        values = {"SV": fl, "DV": fh, "AC": (fh - fl) / seconds}
        if s_curve:
            values |= {"AC": get_register_range(self.map, "AC")[1], "JK": 4 * (fh - fl) / seconds**2}
        return {name: self.clip_to_legal_range(name, value) for name, value in values.items()}

    def can_interpolate(self, drivers: Sequence[NovaDriver]) -> bool:
        if len({id(h.chip) for h in drivers}) > 1 and not all(getattr(h.chip, "linked", False) for h in drivers):
            names = ", ".join(h.axis.name for h in drivers)
            raise ArgumentError(
                f"axes {names} are on several {self.map.chip}, and one interpolates its own: choose axes of one chip, or join "
                "the chips by their multichip lines, Stage(multichip=[...])."
            )
        return True

    def add_interpolation(self, program: OperationsType, drivers: Sequence[NovaDriver]) -> OperationsType:
        """Start the line with this axis as the main one. With several chips, this axis' chip is the master and starts last.

        A single axis makes a relative drive, because LHK1 is for axes of several chips.
        """
        if len(drivers) == 1:
            return self.add_command(program, "DRVRL")
        chips: dict[int, list[NovaDriver]] = {}
        for h in drivers:
            chips.setdefault(id(h.chip), []).append(h)
        mlt, main_chip = self.map.bit("IPM", "MLT"), chips.pop(id(self.chip))
        for own_axes in chips.values():
            own_axes[0].add_register_write(program, "IPM", sum(h.bit for h in own_axes) | SLAVE << mlt)
            own_axes[0].add_command(program, f"LHK{len(own_axes)}")
        self.add_register_write(program, "IPM", sum(h.bit for h in main_chip) | (MASTER << mlt if chips else 0))
        return self.add_command(self.add_command(program, "DECEN"), f"LHK{len(main_chip)}")

    def get_home_search_ranges(self) -> dict[str, tuple[int, int]]:
        return {"step1": (0, 1), "timer": (0, MAX_TIMER_CODES)}

    def add_home_search(
        self, program: Program, fast: bool, timer: int, index: bool, timeout_s: float, rest_s: float
    ) -> list[int]:
        steps = [f"S{k}" for k in (1, 2, 3) if k == 2 or (fast, index)[k == 3]]
        bits = [f"{step}{suffix}" for step in steps for suffix in ("EN", "DR")]
        stop1 = 1 << self.map.bit("H1M", "S1G")
        self.add_register_write(program, "H1M", self.get_mask("H1M", *bits) | stop1)
        length = (timer - 1) << self.map.bit("H2M", "HTM") if timer else 0
        self.add_register_write(program, "H2M", length | (self.get_mask("H2M", "HTME") if timer else 0))
        self.add_command(program, "HMSRC").until_stopped([self.index], SEARCH_TIME_FACTOR * timeout_s)
        at = len(program) - 1
        self.add_command(program, self.STOP).wait(rest_s)
        return [at]

    def find_stop_level_mask(self, number: int) -> tuple[int, int]:
        return 3, self.get_mask("RR3-0", f"STOP{number}")
