"""Descriptions of the bus cycles of a STEP/DIR axis with a TMC5160 in words."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import cycle_descriptions as chip
from pulsestage_trinamic.tmc5160 import maps as chip_maps
from pulsestage_trinamic.tmc5160_step_dir import maps
from stage.chips.cycle_descriptions import Statement
from stage.chips.stepdir import cycle_descriptions as step_timer


def _find_chip_address(address: int) -> int | None:
    """Return the address in the map of the TMC5160, or None for the step timer."""
    if address >= maps.REGISTER_BASE:
        return address - maps.REGISTER_BASE
    if maps.SPI_BASE <= address < maps.SPI_BASE + maps.SPI_ADDRESSES:
        return chip_maps.SPI_CS + address - maps.SPI_BASE
    return None


class CycleDescriber(step_timer.CycleDescriber):
    """Describer of the bus cycles of a STEP/DIR axis with a TMC5160."""

    def write(self, address: int, value: int) -> str:
        chip_address = _find_chip_address(address)
        return super().write(address, value) if chip_address is None else chip.describe_write(chip_address, value)

    def read(self, address: int, value: int) -> str:
        chip_address = _find_chip_address(address)
        if chip_address is None:
            return super().read(address, value)
        return (
            chip.describe_register(chip_address, value, False)
            if chip_address < chip_maps.REGISTERS
            else f"SPI = {value:X}h"
        )


class Decoder(step_timer.Decoder):
    """Decoder of the writes in a journal, which collects the bytes of an SPI datagram until its end."""

    def __init__(self) -> None:
        self._chip = chip.Decoder()

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        chip_address = _find_chip_address(address)
        if chip_address is None:
            return super().decode_write(clock, address, value)
        return self._chip.decode_write(clock, chip_address, value)

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        chip_address = _find_chip_address(address)
        if chip_address is None:
            return super().describe_lost_write(address, value)
        return self._chip.describe_lost_write(chip_address, value)

    def reset(self) -> None:
        self._chip.reset()
