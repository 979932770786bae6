"""The host driver of the TOY and the TOY8."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

from stage.errors import ArgumentError
from stage.firmware.driver import Driver, ImmediateOperations, Speeds, wait_until_stopped
from stage.firmware.move_report import ProcedureObserver, Report
from stage.sim.program import Operations


class ToyDriver(Driver):
    def move(self, pulses: int, speeds: Speeds, timeout: float | None = None) -> Report:
        self.chip.MAP.check_value(self._get_axis_name("COUNT"), abs(pulses))
        with ProcedureObserver(self.axis, "move") as p:
            self.write_move(ImmediateOperations(self.axis), {"RATE": round(speeds.start)}, pulses)
            wait_until_stopped([self.axis], timeout or 2 * abs(pulses) / speeds.start + 1)
            self.axis.wait(0.05)
            return p.make_report(self.read_stop_reason() or "all pulses", pulses)

    def home(self, direction: int, speeds: Speeds, index: int = 0, timeout: float = 60.0) -> NoReturn:
        raise ArgumentError("a TOY has no origin return: move it, and look at ORG.")

    def start_continuous_move(self, direction: int, speeds: Speeds) -> None:
        self.write_move(ImmediateOperations(self.axis), {"RATE": round(speeds.start)}, direction * 0xFFFF)

    def halt(self, at_once: bool = False) -> None:
        self.chip.write(0, self._get_command_code("STOP"))

    def _get_axis_name(self, name: str) -> str:
        """Return the name of this axis' register or command, with its index on a chip of several axes."""
        return name if self.chip.AXES == 1 else f"{name}{self.axis.chip_axis}"

    def _get_command_code(self, symbol: str) -> int:
        return self.chip.MAP.command(self._get_axis_name(symbol)).code

    def read_stop_reason(self) -> str:
        if not self.chip.read(self.chip.MAP.register(self._get_axis_name("COUNT")).number):
            return ""
        return "EL+" if self.axis.pins.el_plus else "EL-"

    def list_move_registers(self, s_curve: bool | None) -> tuple[str, ...]:
        if s_curve:
            raise self.build_s_curve_error()
        return ("RATE",)

    def compute_move_registers(
        self, fl: float, fh: float, up: float, down: float, pulses: int, s_curve: bool | None = None
    ) -> dict[str, int]:
        return {"RATE": round(fl)}

    def write_move(self, program: Operations, values: Mapping[str, int], pulses: int) -> None:
        for name, value in {**values, "COUNT": abs(pulses)}.items():
            program.register(self.index, self.chip, name, value, self.axis.chip_axis)
        program.command(self.index, self._get_command_code("PLUS" if pulses > 0 else "MINUS"))

    def write_stop(self, program: Operations) -> None:
        program.command(self.index, self._get_command_code("STOP"))

    def build_home_program(self, settings: Any) -> NoReturn:
        raise ArgumentError("a TOY has no origin return.")
