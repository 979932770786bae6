"""State record and pins of a STEP/DIR axis with a TMC5160 whose pin SD_MODE is high."""

from __future__ import annotations

from pulsestage_trinamic import motor_field
from pulsestage_trinamic.tmc5160 import state as chip
from stage.chips.stepdir import state as lines
from stage.native import record

NEVER = lines.NEVER
STATE = record(
    [
        *((name, lines.STATE[name]) for name in lines.STATE.names),
        *motor_field.STATE_FIELDS,
        ("followed", "i8"),  # `net` up to which the field has followed the steps
        ("driver", chip.STATE, (1,)),  # the chip, in its own clock; its ramp generator is off
    ]
)
"""State of one STEP/DIR axis with a TMC5160."""

_FAULT_AND_OUTPUT_NAMES = ("s2ga", "s2gb", "s2vsa", "s2vsb", "ot", "otpw", "ola", "olb", "uv_cp", "diag0", "diag1")
INPUTS = {**lines.INPUTS, **{name: 1 << (len(lines.INPUTS) + k) for k, name in enumerate(_FAULT_AND_OUTPUT_NAMES)}}
"""Pins of the lines, faults of the power stage, and the chip's outputs, which the host reads as it reads the switches."""
DIAG0, DIAG1 = INPUTS["diag0"], INPUTS["diag1"]
CHIP_DRIVEN_PINS = DIAG0 | DIAG1
OUTPUTS = lines.OUTPUTS
FIRST_FAULT = len(lines.INPUTS)
"""Number of the first bit of the faults; they follow in the order of the chip's own."""
DIAG0_ERROR, DIAG0_OTPW, DIAG0_STALL, DIAG1_STALL, DIAG1_INDEX = (1 << bit for bit in (5, 6, 7, 8, 9))
"""Bits of GCONF with SD_MODE high; 7 and 8 mean steps and direction otherwise."""
INTPOL, DEDGE = chip.MAP.masks("CHOPCONF", "intpol", "dedge")
