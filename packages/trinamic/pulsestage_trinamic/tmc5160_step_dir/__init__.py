"""Trinamic TMC5160 with SD_MODE high: the power stage of a STEP/DIR axis, configured by SPI.

from stage import Stage, firmware
machine = Stage("xyz", chips="stepdir", drives="tmc5160")
chip = machine.axes["x"].chip
firmware.move(machine.axes["x"], 10e-3)                        switches the power stage on, and moves by STEP and DIR
chip.transfer(bytes.fromhex("EC050100C3"))                   an SPI datagram; returns the answer to the one before
chip.write_register("CHOPCONF", 0x140100C3)                  a register without SPI
"""

from __future__ import annotations

from typing import Any, ClassVar

from pulsestage_trinamic.motor_field import PLACES_PER_FULL_STEP
from pulsestage_trinamic.step_dir_axis_with_registers import StepDirAxisWithRegisters
from pulsestage_trinamic.tmc5160_step_dir import core, maps
from pulsestage_trinamic.tmc5160_step_dir.cycle_descriptions import CycleDescriber, Decoder
from pulsestage_trinamic.tmc5160_step_dir.maps import MAP
from stage.chips.stepdir.line_names import Line
from stage.errors import ArgumentError

__all__ = ["StepDirTMC5160"]

SPI_DATAGRAM_ADDRESS = maps.SPI_BASE + 2
STALL_MASKS = dict(zip(("diag0", "diag1"), MAP.masks("GCONF", "diag0_step", "diag1_dir"), strict=True))
"""Bits of GCONF with which DIAG0 and DIAG1 show a stall while SD_MODE is high."""


class StepDirTMC5160(StepDirAxisWithRegisters):
    """STEP/DIR axis with a TMC5160. After power-up the power stage is off (TOFF = 0) and a step is 1/256 full step.

    Positions count in the microsteps of the axis' Drive, whatever MRES is.

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
    WIRES: ClassVar = {"diag0": ("DIAG0_n", 0), "diag1": ("DIAG1_n", 0)}
    ADDRESSES: ClassVar = maps.ADDRESSES
    ADDRESS_MASK: ClassVar = maps.ADDRESSES - 1
    DATA_MASK: ClassVar = maps.MASK_40_BITS
    DRIVER: ClassVar = "pulsestage_trinamic.tmc5160_step_dir.host_driver:StepDirTmc5160Driver"

    diag0, diag1 = Line("diag0"), Line("diag1")

    def __init__(self, clock_hz: int | None = None, rsense: float = 0.1, f_clk: int = 12_000_000):
        if isinstance(rsense, bool) or not isinstance(rsense, int | float) or not 0.001 <= rsense <= 10:
            raise ArgumentError(
                f"rsense={rsense!r}: sense resistors have 0.001 to 10 ohm; 0.1 ohm allows up to 2.3 A RMS."
            )
        if isinstance(f_clk, bool) or not isinstance(f_clk, int) or not 1_000_000 <= f_clk <= 20_000_000:
            raise ArgumentError(
                f"f_clk={f_clk!r}: the chip's clock is a whole number of 1 to 20 MHz; its own is 12 MHz."
            )
        self.rsense, self.f_clk = float(rsense), f_clk
        super().__init__(clock_hz)

    def _configure(self, record: Any) -> None:
        super()._configure(record)
        record["unit"] = 1
        record["driver"]["hz"], record["driver"]["rsense"] = self.f_clk, self.rsense

    def options(self) -> dict[str, Any]:
        return {"clock_hz": self.clock_hz, "rsense": self.rsense, "f_clk": self.f_clk}

    def fit_drive(self, drive: Any, axis: int = 0) -> None:
        """Take the number of microsteps from the drive of the axis: positions are counted in microsteps of the drive."""
        super().fit_drive(drive, axis)
        self._record["unit"] = PLACES_PER_FULL_STEP // drive.microsteps

    # --- SPI, load and current ---

    def transfer(self, datagram: bytes) -> bytes:
        """Send an SPI datagram of 5 bytes and return the 5 bytes of the answer to the one before. Raises ArgumentError."""
        if len(datagram) != 5:
            raise ArgumentError(f"transfer({bytes(datagram)!r}): a datagram has 5 bytes, address first.")
        self.write(SPI_DATAGRAM_ADDRESS, int.from_bytes(datagram, "big"))
        return int(self.read(SPI_DATAGRAM_ADDRESS)).to_bytes(5, "big")

    def set_load(self, lam: int, emf: int = 1024) -> None:
        """Set the load that StallGuard2 measures from now on, for a chip that is not on a stage. Journals do not record it.

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
        gconf = self.read_register("GCONF")
        return tuple(name for name, mask in STALL_MASKS.items() if gconf & mask)

    def explain_missing_current(self, axis: int = 0) -> str:
        """Explain why the power stage supplies no current to the motor; "" if it does."""
        if self.amplitude:
            return ""
        if not self.state["driver"]["powered"][0]:
            return "its power stage was never switched on (CHOPCONF.TOFF = 0 after power-up, or ENABLE is not asserted)"
        return "its power stage is off (TOFF = 0, ENABLE not asserted, a fault, or FREEWHEEL at IHOLD = 0)"

    # --- interface of the chip registry ---

    def decoder(self, axis: int = 0) -> Decoder:
        self._check_axis(axis)
        return Decoder()

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber()
