"""Registers of a STEP/DIR axis with a TMC5160: the step timer at 0 to Fh, SPI at 10h to 13h, the chip's registers at 80h to FFh."""

from __future__ import annotations

from dataclasses import replace

from pulsestage_trinamic.tmc5160 import maps as chip
from stage.chips.register_map import RegisterMap
from stage.chips.stepdir.maps import MAP as STEP_TIMER

SPI_BASE, SPI_ADDRESSES = 0x10, 4
"""Bus addresses of chip select, a byte, a whole datagram and SPI_STATUS, in this order."""
REGISTER_BASE, ADDRESSES = 0x80, 0x100
MASK_40_BITS = chip.M40

MAP = RegisterMap(
    "TMC5160 (SD_MODE)",
    "Trinamic TMC5160 with SD_MODE high: STEP/DIR driver of one two-phase stepper, SPI of 40 bits; with a step timer",
    "data sheet TMC5160/TMC5160A rev. 1.14; see tmc5160_sheet.md of this package",
    (
        *STEP_TIMER.registers,
        *(replace(r, number=REGISTER_BASE + r.number) for r in chip.MAP.registers if r.name != "OUTPUT"),
    ),
    (*STEP_TIMER.words, *chip.MAP.words),
    STEP_TIMER.commands,
)
"""Register map of the axis: the step timer, SPI, and the registers of the chip."""
