"""Trinamic TMC2209: STEP/DIR driver of one two-phase stepper, as the power stage of a STEP/DIR axis.

from stage import Stage
machine = Stage("xyz", chips="stepdir", drives="tmc2209")      an entry point of the package makes the name known
chip = machine.axes["x"].chip
chip.write_register("CHOPCONF", 0x10010053)                  writes a register directly, without the UART
chip.uart.write(bytes.fromhex("05000048"))                   sends a datagram, from now on
machine.run(2e-3)
chip.uart.read()                                             the reply, as far as it has come
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from pulsestage_trinamic.motor_field import PLACES_PER_FULL_STEP
from pulsestage_trinamic.step_dir_axis_with_registers import StepDirAxisWithRegisters
from pulsestage_trinamic.tmc2209 import core, lint, maps, power_stage, state
from pulsestage_trinamic.tmc2209.cycle_descriptions import CycleDescriber, Decoder
from pulsestage_trinamic.tmc2209.maps import MAP
from pulsestage_trinamic.tmc2209.state import MS1, MS2
from pulsestage_trinamic.tmc2209.uart_port import UartPort
from stage.chips.stepdir.line_names import Line
from stage.chips.write_diagnostics import Cause, Diagnostic, Finding
from stage.errors import ArgumentError

__all__ = ["TMC2209"]

DEFAULT_BAUD = 115_200


class TMC2209(StepDirAxisWithRegisters):
    """STEP/DIR axis with a TMC2209. Pins are True while asserted or high; hosts read its outputs DIAG and INDEX like switches.

    Positions count in the microsteps of the axis' Drive, whatever the chip is set to: a host whose steps per millimeter do not fit
    MRES moves a wrong distance, as in silicon.

    Args:
        clock_hz: Frequency at which edges of the lines are placed, Hz; default: 1 GHz.
        rsense: Resistance of each sense resistor, ohm.
        f_clk: Frequency of the chip's own clock, Hz.

    Raises:
        ArgumentError: A value that no chip or module has.
    """

    MAP: ClassVar = MAP
    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    ADDRESSES: ClassVar = maps.ADDRESSES
    ADDRESS_MASK: ClassVar = maps.ADDRESSES - 1
    READING_ACTS: ClassVar = frozenset({maps.UART_BYTE})
    DRIVER: ClassVar = "pulsestage_trinamic.tmc2209.host_driver:Tmc2209Driver"

    diag, index = Line("diag"), Line("index")

    def __init__(self, clock_hz: int | None = None, rsense: float = 0.11, f_clk: int = 12_000_000):
        if isinstance(rsense, bool) or not isinstance(rsense, int | float) or not 0.001 <= rsense <= 10:
            raise ArgumentError(f"rsense={rsense!r}: sense resistors have 0.001 to 10 ohm; 0.11 ohm is usual.")
        if isinstance(f_clk, bool) or not isinstance(f_clk, int) or not 1_000_000 <= f_clk <= 20_000_000:
            raise ArgumentError(
                f"f_clk={f_clk!r}: the chip's clock is a whole number of 1 to 20 MHz; its own is 12 MHz."
            )
        self.rsense, self.f_clk = float(rsense), f_clk
        super().__init__(clock_hz)
        self.uart = UartPort(self)

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        record["f_clk"], record["rsense"], record["vref"], record["unit"] = self.f_clk, self.rsense, 1.0, 16
        record["bit_ns"], record["arrives"] = round(1e9 / DEFAULT_BAUD), core.state.NEVER
        record["inputs"] |= MS1 | MS2

    def options(self) -> dict[str, Any]:
        return {"clock_hz": self.clock_hz, "rsense": self.rsense, "f_clk": self.f_clk}

    def fit_drive(self, drive: Any, axis: int = 0) -> None:
        """Take what the chip needs from the drive of the axis.

        MS1 and MS2 get the levels of the drive's microsteps; microsteps that only MRES selects need a host that writes it. VREF is
        set so that IRUN = 31 gives the drive's current, up to 2.5 V.
        """
        super().fit_drive(drive, axis)
        c = self._record
        c["unit"] = PLACES_PER_FULL_STEP // drive.microsteps
        levels = drive.power_stage.microsteps.get(drive.microsteps, "")
        if levels and drive.power_stage.chip:
            word = int(c["inputs"]) & ~(MS1 | MS2)
            c["inputs"] = word | (MS1 if levels[0] == "H" else 0) | (MS2 if levels[1] == "H" else 0)
        full_scale = power_stage.FULL_SCALE_V / (self.rsense + power_stage.INTERNAL_OHM)
        c["vref"] = min(1.0, drive.amplitude / full_scale)
        c["ir_share"] = drive.motor.resistance / drive.bus_voltage

    @property
    def diagnostics(self) -> list[Diagnostic]:
        """Messages about writes that break a rule, about datagrams that did nothing, and about settings that exclude each other.

        Datagrams of one kind have one message.
        """
        diagnostics = super().diagnostics
        for clock, finding in lint.find_uart_findings(self.state, self.uart.address):
            self.diagnose(clock, maps.UART_BYTE, 0, [finding])
        return diagnostics

    def find_cause_of(self, diagnostic: Diagnostic) -> Cause:
        if diagnostic.key in lint.IGNORED_DATAGRAM_KIND_BY_RULE_KEY:
            return Cause(
                "datagram", int(self.state["mistakes"][lint.IGNORED_DATAGRAM_KIND_BY_RULE_KEY[diagnostic.key]])
            )
        if diagnostic.address in (maps.UART_BYTE, maps.UART_OTHER):
            return Cause("setting", 1)
        return super().find_cause_of(diagnostic)

    # --- load and current ---

    def set_load(self, lam: int, emf: int = 1024) -> None:
        """Set the load that StallGuard4 measures from now on, for a chip that is not on a stage. Journals do not record it.

        Args:
            lam: Load torque; 1024 is the torque at a load angle of 90 degrees.
            emf: Back EMF; 1024 is the supply.

        Raises:
            ArgumentError: The chip is on a stage, or a value is not within 0 to 1024.
        """
        if self.attached or not (0 <= lam <= 1024 and 0 <= emf <= 1024):
            raise ArgumentError(
                f"set_load({lam!r}, {emf!r}): both values are 0 to 1024. The motor of a stage sets the load of its chip itself."
            )
        core.set_fixed_load.with_gil(self.pointer, int(lam), int(emf))

    def list_configured_outputs(self) -> tuple[str, ...]:
        registers = self.state["registers"]
        return ("diag",) if registers[state.SGTHRS] and registers[state.TCOOLTHRS] else ()

    def explain_output_mistake(self, name: str) -> str:
        registers = self.state["registers"]
        if name != "diag" or registers[state.SGTHRS] or not registers[state.TCOOLTHRS]:
            return ""
        return "SGTHRS is 0, as after a reset, so that DIAG shows a stall at SG_RESULT 0 only, which a real motor need not reach"

    def explain_missing_current(self, axis: int = 0) -> str:
        """Explain why the power stage supplies no current to the motor; "" if it does."""
        if self.amplitude:
            return ""
        return (
            super().explain_missing_current(axis)
            or "its power stage is off (TOFF = 0, a fault, or FREEWHEEL at IHOLD = 0)"
        )

    # --- interface of the chip registry ---

    def lint(self, address: int, value: int) -> Iterator[Finding]:
        yield from lint.lint_write(self._record, address, value)

    def decoder(self, axis: int = 0) -> Decoder:
        self._check_axis(axis)
        return Decoder()

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber()
