"""Parameters by their command codes, and the axis that a host reads, for the buses of all NOVA chips; compiled."""

from __future__ import annotations

from typing import NamedTuple

from stage.chips.nova.motion import single_axis_drive
from stage.chips.nova.state import DV, MAX_CHIP_AXES, REGISTERS, TP
from stage.chips.register_map import RegisterMap
from stage.native import hot


class ParameterTable(NamedTuple):
    """Parameters of a chip by the command codes that write them. In the masks bit k stands for command code k.

    Attributes:
        writes: Mask of the codes that write a parameter.
        signed: Mask of the codes whose parameter has a sign.
        short: Mask of the codes whose parameter has 16 bits.
        places: Codes of the parameters that are not 0 after a reset.
        values: Values after a reset of the parameters in `places`.
    """

    writes: int
    signed: int
    short: int
    places: tuple[int, ...]
    values: tuple[int, ...]


def list_parameters(map_: RegisterMap) -> ParameterTable:
    """List the parameters of a chip's register map."""
    registers = [r for r in map_.registers if r.number < REGISTERS]
    after_reset = [r for r in registers if r.reset]
    return ParameterTable(
        sum(1 << chip.code for chip in map_.commands if chip.kind == "data write" and chip.code < REGISTERS),
        sum(1 << r.number for r in registers if r.signed),
        sum(1 << r.number for r in registers if r.bits == 16),
        tuple(r.number for r in after_reset),
        tuple(r.reset or 0 for r in after_reset),
    )


@hot
def read_parameter_value(chip, signed, short):
    """Return the value of a parameter that the data in WR6 and WR7 represent.

    Args:
        chip: State of the chip.
        signed: Whether the parameter has a sign.
        short: Whether it has 16 bits.
    """
    bits = 16 if short else 32
    word = (chip.data_high << 16 | chip.data_low) & (1 << bits) - 1
    return word - (1 << bits) if signed and word >> (bits - 1) else word


@hot
def write_parameter(chip, axis, code, value):
    """Write a parameter of an axis by the code of its command."""
    if code == DV:
        single_axis_drive.change_drive_speed(chip, axis, value)
    elif code == TP:
        single_axis_drive.change_pulse_count(chip, axis, value)
    else:
        axis.reg[code] = value
    chip.stale = 1


@hot
def find_lowest_axis(chip):
    """Return the index of the lowest selected axis, from which a host reads."""
    for j in range(MAX_CHIP_AXES):
        if chip.selected >> j & 1:
            return j
    return 0
