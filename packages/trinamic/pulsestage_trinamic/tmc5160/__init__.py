"""Trinamic TMC5160: six-point ramp generator and motor driver of one two-phase stepper, as a chip of PulseStage.

from stage import Stage
machine = Stage("xy", chips="tmc5160")              an entry point of the package makes the name known
chip = machine.axes["x"].chip
chip.transfer(bytes.fromhex("EC000100C3"))        sends an SPI datagram and returns the answer to the one before
chip.write(0x2D, 51200)                           writes a register directly, without SPI
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

from pulsestage_trinamic.tmc5160 import core, encoder, lint
from pulsestage_trinamic.tmc5160.cycle_descriptions import CycleDescriber, Decoder
from pulsestage_trinamic.tmc5160.maps import ADDRESSES, M32, M40, MAP, MOTION, SPI_DATAGRAM
from stage.chips.chip import Chip
from stage.chips.write_diagnostics import Finding
from stage.errors import ArgumentError, StageError

__all__ = ["TMC5160"]


class TMC5160(Chip):
    """TMC5160 that controls one axis. Input pins are True at a high level, output pins while they are active.

    A pulse moves the field by 1/256 full step for every value of MRES; XACTUAL counts steps of 2^MRES pulses.

    Args:
        clock_hz: Frequency of the chip's clock, Hz; default: 12 MHz.
        rsense: Resistance of each sense resistor, ohm. With GLOBALSCALER, IRUN and IHOLD it sets the motor's current on a stage.
    """

    MAP: ClassVar = MAP
    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    WIRING: ClassVar = {"el_plus": "refr", "el_minus": "refl", "ez": "encn"}
    LOGIC: ClassVar = "positive"
    ENCODERS: ClassVar = True
    WIRES: ClassVar = {"diag0": ("DIAG0_n", 0), "diag1": ("DIAG1_n", 0), "drv_enn": ("DRV_ENN", 1)}
    MICROSTEPS: ClassVar = 256
    LAYOUT: ClassVar = "pulsestage_trinamic.tmc5160.bus_layout:SPI"
    DRIVER: ClassVar = "pulsestage_trinamic.tmc5160.host_driver.driver:Tmc5160Driver"
    DEFAULT_CLOCK_HZ: ClassVar = 12_000_000
    ADDRESSES: ClassVar = ADDRESSES
    ADDRESS_MASK: ClassVar = 0xFF
    DATA_MASK: ClassVar = M40
    BUSY: ClassVar = (MOTION, 1)
    COUNTER: ClassVar = ("XACTUAL", 32)
    IRQ: ClassVar = (0, core.OUTPUTS["diag0"])
    IN_POSITION: ClassVar = 64.0

    def __init__(self, clock_hz: int | None = None, rsense: float = 0.1):
        """Power the chip up. Raises ArgumentError."""
        if isinstance(rsense, bool) or not isinstance(rsense, int | float) or not 0.001 <= rsense <= 10:
            raise ArgumentError(
                f"rsense={rsense!r}: sense resistors have 0.001 to 10 ohm; 0.1 ohm allows up to 2.3 A RMS."
            )
        self.rsense, self._timed = float(rsense), False
        super().__init__(clock_hz)

    def _configure(self, record: Any) -> None:
        record["hz"], record["rsense"] = self.clock_hz, self.rsense

    def options(self) -> dict[str, Any]:
        return {"clock_hz": self.clock_hz, "rsense": self.rsense}

    # --- SPI ---

    def transfer40(self, datagram: int) -> int:
        """Send a datagram of 40 bits, and return the answer to the datagram before: status byte and 32 bits of data."""
        self.write(SPI_DATAGRAM, datagram)
        return int(self.read(SPI_DATAGRAM))

    def transfer(self, datagram: bytes) -> bytes:
        """Send a datagram of 5 bytes and return the 5 bytes of its answer, see `transfer40`. Raises ArgumentError."""
        if len(datagram) != 5:
            raise ArgumentError(f"transfer({bytes(datagram)!r}): a datagram has 5 bytes, address first.")
        return self.transfer40(int.from_bytes(datagram, "big")).to_bytes(5, "big")

    # --- load of a chip that is not on a stage ---

    def set_load(self, lam: int, emf: int = 1024) -> None:
        """Set the load that StallGuard measures from now on, for a chip that is not on a stage. Journals do not record it.

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

    def set_input_word(self, axis: int, word: int) -> None:
        if self._record["fed"] and (word ^ self.input_word(axis)) & encoder.PINS:
            raise StageError("The axis' encoder drives ENCA and ENCB; they cannot be set directly.")
        super().set_input_word(axis, word)

    def get_shaft(self, axis: int) -> tuple[float, float]:
        return float(self.state["shaft"]), float(self.state["shaft_rate"])

    @property
    def amplitude(self) -> float:
        """Amplitude of the phase currents that the registers request, A; 0 while the power stage is off."""
        return float(core.read_motor_current.with_gil(self.pointer, 0))

    def explain_missing_current(self, axis: int = 0) -> str:
        """Explain why the power stage supplies no current to the motor; "" if it does. A vertical axis falls without it."""
        if self.amplitude:
            return ""
        if not self.state["powered"]:
            return "its power stage was never switched on (CHOPCONF.TOFF = 0 after power-up, or DRV_ENN is high)"
        return "its power stage is off (TOFF = 0, DRV_ENN high, a fault, or FREEWHEEL at IHOLD = 0)"

    # --- interface of the chip registry ---

    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        """Return the bus cycles that write a register: one write to its own address."""
        return [(cls.MAP.register(name).number, value & M32)]

    def values(self) -> dict[str, int]:
        pointer = self.pointer
        return {
            r.name: r.value(core.get_register_value.with_gil(pointer, r.number))
            for r in MAP.registers
            if r.name != "OUTPUT"
        }

    def decoder(self, axis: int = 0) -> Decoder:
        return Decoder()

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber(self.state)

    def lint(self, address: int, value: int) -> Iterator[Finding]:
        yield from lint.lint_write(self._record, address, value)
        if self.attached or self._timed:
            yield from lint.lint_timing(self._record, address, value)

    def make_replica(self, state: bytes | None = None) -> TMC5160:
        """Return a copy. If this chip is on a stage, whose bus takes time, the copy checks the timing of writes as well."""
        replica = super().make_replica(state)
        assert isinstance(replica, TMC5160)
        replica._timed = self.attached or self._timed
        return replica
