"""`StepDirAxisWithRegisters`: STEP/DIR axes whose power stage has registers of 32 bits beside the step timer."""

from __future__ import annotations

from typing import Any, ClassVar

from pulsestage_trinamic.motor_field import PLACES_PER_FULL_STEP
from stage.chips.stepdir import STEPDIR

MAX_REGISTER_VALUE = 0xFFFF_FFFF


class StepDirAxisWithRegisters(STEPDIR):
    """Base class of a STEP/DIR axis whose power stage has registers, read and written by name."""

    CORE: ClassVar[Any]

    @property
    def microsteps(self) -> int:
        """Microsteps of a full step that the chip makes of a step now."""
        return PLACES_PER_FULL_STEP // int(self.CORE.get_step_places.with_gil(self.pointer))

    @property
    def amplitude(self) -> float:
        """Amplitude of the phase currents now, A."""
        return float(self.CORE.read_motor_current.with_gil(self.pointer, 0))

    def read_register(self, name: str) -> int:
        """Return the value of a register by its name, even if a host cannot read it. No time passes. Raises ArgumentError."""
        register = self.MAP.register(name)
        return int(register.value(self.CORE.get_register_value.with_gil(self.pointer, register.number)))

    def write_register(self, name: str, value: int) -> None:
        """Write a register by its name, by one bus cycle and without UART or SPI. Raises ArgumentError."""
        for address, datum in self.register_cycles(name, value):
            self.write(address, datum)

    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        return [(address, datum & MAX_REGISTER_VALUE) for address, datum in super().register_cycles(name, value, axis)]

    def values(self) -> dict[str, int]:
        pointer = self.pointer
        return {r.name: r.value(self.CORE.get_register_value.with_gil(pointer, r.number)) for r in self.MAP.registers}
