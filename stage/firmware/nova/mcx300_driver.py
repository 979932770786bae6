"""Driver of the MCX304, MCX302, MCX312 and MCX314As, NOVA's first generation, whose speeds are multiples of a range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from stage.chips.nova import MCX314AS
from stage.chips.nova.registers.mcx300 import MCX304_MAP, UNIT_MULTIPLE_RANGE
from stage.firmware.driver import SETTLING_TIME_S, ImmediateOperations, Speeds, wait_until_stopped
from stage.firmware.move_report import ProcedureObserver, Report
from stage.firmware.nova.chip_port import compute_logic_bits
from stage.firmware.nova.driver import HOME_SPEED_PPS, SEARCH_TIME_FACTOR, NovaDriver, OperationsType
from stage.firmware.parameter_ranges import get_register_range
from stage.sim.program import Operations, Program

HMST = MCX304_MAP.field("RR2", "HMST")
HMST_REVERSE_SEARCH_CODE = HMST.find_code("step 2: waits for STOP1 in the other direction")
"""Value of HMST while the chip searches in the opposite direction, because the end limit came before the signal."""
FILTER_CODE = 4
"""Of FL, in the search at HV: an input counts when it was steady for 2 ms, so that a contact that bounces has one edge. That is
less than a pulse at HV; at the drive speed it would be many, and there the inputs have no filter."""
SPEED_MULTIPLE = 20
"""Of the first generation: R = 8,000,000 / 20, so that a unit of SV and V is 20 pps."""


class Mcx300Driver(NovaDriver):
    """Driver of MCX304, MCX302, MCX312 and MCX314As, whose speeds are multiples of 8,000,000 / R pps; R is the range register.

    The first, fast step of the chips' automatic home search ignores ORG. Therefore the driver makes a continuous drive until STOP1
    (ORG) instead, and then starts the automatic search without its first step.
    """

    SPEEDS: ClassVar = ("SV", "V", "A")
    JERK: ClassVar = "K"
    UNIT: ClassVar = SPEED_MULTIPLE
    DISTANCE_REGISTER: ClassVar = "P"
    SIGNED: ClassVar = False
    STOP: ClassVar = "STOP_SUDDEN"
    SLOW_DOWN: ClassVar = "STOP_DEC"
    RUN: ClassVar = ("C_DRV_P", "C_DRV_M")
    END_WORD: ClassVar = "RR1"

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> Report:
        registers = self._compute_registers(speeds._replace(s_curve=False), 1)
        with ProcedureObserver(self.axis, "origin return") as observer:
            self._write_modes_and_registers(registers)
            now = ImmediateOperations(self.axis)
            self.add_register_write(now, "HV", self.clip_to_legal_range("HV", HOME_SPEED_PPS / self.UNIT))
            self._add_run_to_signal(now, direction, timeout, SETTLING_TIME_S)
            address, stop1 = self.find_stop_level_mask(1)
            stop_reason = self.read_stop_reason()
            if stop_reason in ("EL+", "EL-") and bool(
                self.chip.read(address) & stop1
            ) != self.is_stop_input_active_high(1):
                return observer.make_report(stop_reason)
            self._add_search_start(now, bool(index), direction, FILTER_CODE)
            at_limit = self._wait_for_search(timeout)
            self.add_command(now, self.STOP).wait(2 * SETTLING_TIME_S)
            if at_limit:
                return observer.make_report("EL-" if direction < 0 else "EL+")
            if self.port.read_status_register(2) & self.get_mask("RR2", "HOME"):
                return observer.make_report("HOME")
            # what ended its last drive: a limit, where ORG is stuck
            return observer.make_report(self.read_stop_reason() or "HOME")

    def _wait_for_search(self, timeout: float) -> bool:
        """Wait until the home search is over, and return whether an end limit has ended it.

        If the end limit comes before ORG, the chip searches ORG on the way back. If ORG ends before the limit does, the chip finds
        no edge there and goes on forever, so the driver stops it.
        """
        back: list[bool] = []

        def stop_at_limit() -> None:
            """Stop the axis if the NOVA chip searches back for home from an end limit."""
            if not back and self.port.read_status_register(2) & HMST.mask == HMST_REVERSE_SEARCH_CODE:
                back.append(True)
                self.port.write_command(self.STOP)

        wait_until_stopped([self.axis], timeout, on_poll=stop_at_limit)
        return bool(back)

    def add_end_status_clear(self, program: OperationsType) -> OperationsType:
        """Return the operations unchanged: the end status of a drive stays until the next drive begins."""
        return program

    def add_drive_modes(self, program: OperationsType, s_curve: bool = False) -> OperationsType:
        limit_bits = compute_logic_bits(self.axis, "WR2")
        wr2 = {"WR2": limit_bits} if limit_bits else {}
        wr3 = self.get_mask("WR3", "SACC") if s_curve else 0
        self.add_mode_words(program, WR1=self._compute_wr1(), **wr2, WR3=wr3)
        if isinstance(self.chip, MCX314AS):
            self.add_register_write(program, "EM", 0)
        self.add_register_write(program, "R", UNIT_MULTIPLE_RANGE // SPEED_MULTIPLE)
        return self.add_register_write(program, "AO", 0)

    def _compute_wr1(self, *bit_names: str) -> int:
        """Return a value of the mode word WR1 with the logic of the sensors and the named bits."""
        return self.get_mask("WR1", *bit_names) | compute_logic_bits(self.axis, "WR1")

    def add_drive(self, program: OperationsType, pulses: int) -> OperationsType:
        return self.add_command(
            self.add_register_write(program, "P", abs(pulses)), "F_DRV_P" if pulses >= 0 else "F_DRV_M"
        )

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        """Compute A = (V - SV) / (125 m ta), and K from the jerk 4 (V - SV) / ta^2. The longer ramp time counts for both ramps."""
        seconds = max(up, down)
        values = {
            "SV": fl / SPEED_MULTIPLE,
            "V": fh / SPEED_MULTIPLE,
            "A": (fh - fl) / seconds / (125 * SPEED_MULTIPLE),
        }
        if s_curve:
            max_jerk = get_register_range(self.map, "K")[1]  # also where nothing is to be ramped
            jerk = 62_500_000 * SPEED_MULTIPLE * seconds**2 / (4 * (fh - fl)) if fh > fl else max_jerk
            values |= {"A": get_register_range(self.map, "A")[1], "K": jerk}
        return {name: self.clip_to_legal_range(name, value) for name, value in values.items()}

    def can_interpolate(self, drivers: Sequence[NovaDriver]) -> bool:
        has_it = any(c.symbol == f"IP_{len(drivers)}ST" for c in self.map.commands)
        return has_it and len({id(h.chip) for h in drivers}) == 1

    def add_interpolation(self, program: OperationsType, drivers: Sequence[NovaDriver]) -> OperationsType:
        places = (h.axis.chip_axis << self.map.bit("WR5", f"AX{k}") for k, h in enumerate(drivers, 1))
        program.write(self.index, 5, sum(places))
        return self.add_command(self.add_command(program, "IP_DEC_VALID"), f"IP_{len(drivers)}ST")

    def get_home_search_ranges(self) -> dict[str, tuple[int, int]]:
        return {"step1": (0, 1)}

    def add_home_search(
        self, program: Program, fast: bool, timer: int, index: bool, timeout_s: float, rest_s: float
    ) -> list[int]:
        limit_s = SEARCH_TIME_FACTOR * timeout_s
        if fast:
            first = self._add_run_to_signal(program, -1, limit_s, rest_s)
        else:
            self.add_command(program, self.NOP)  # programs are alike: three operations
            program.wait(0).wait(0)
            first = self._add_stop_wait(program, limit_s, rest_s)
        self._add_search_start(program, index, -1, 0)
        return [first, self._add_stop_wait(program, limit_s, rest_s)]

    def _add_run_to_signal(self, program: Operations, direction: int, timeout_s: float, rest_s: float) -> int:
        """Add a continuous drive that STOP1 or a limit ends; return the index of the operation that polls for the stop."""
        self.add_command(self.add_mode_words(program, WR1=self._compute_wr1("SP1-E")), self.RUN[direction < 0])
        return self._add_stop_wait(program, timeout_s, rest_s)

    def _add_search_start(self, program: Operations, index: bool, direction: int, filter_code: int) -> None:
        """Add the start of the automatic home search to a program.

        Args:
            program: Program, or operations that are done at once.
            index: Whether the search goes on to the index pulse.
            direction: Direction in which ORG lies, 1 or -1.
            filter_code: Code FL of the input filter of the switches; 0: none.
        """
        extended = isinstance(self.chip, MCX314AS)  # its filters are in EM
        place = "EM" if extended else "WR3"
        filters = (self.get_mask(place, "FE0") | filter_code << self.map.bit(place, "FL")) if filter_code else 0
        self.add_mode_words(program, WR1=self._compute_wr1(), **({"WR3": filters} if filters and not extended else {}))
        steps = ["ST2", "ST3"][: 1 + index]
        bits = [f"{step}-E" for step in steps] + [f"{step}-D" for step in steps if direction < 0]
        mode = "EM" if extended else "HM"
        self.add_register_write(program, mode, self.get_mask(mode, *bits) | (filters if extended else 0))
        self.add_command(program, "HOME_EXEC")

    def _add_stop_wait(self, program: Operations, timeout_s: float, rest_s: float) -> int:
        """Add the wait for the end of a drive and a rest; return the index of the operation that polls for the stop."""
        at = len(program)
        program.until_stopped([self.index], timeout_s)
        self.add_command(program, self.STOP).wait(rest_s)
        return at

    def find_stop_level_mask(self, number: int) -> tuple[int, int]:
        axis = self.axis.chip_axis
        word = f"RR{4 + axis // (1 if self.chip.AXES == 2 else 2)}"
        return int(word[2:]), self.get_mask(word, f"{'XYZU'[axis]}-STOP{number}")
