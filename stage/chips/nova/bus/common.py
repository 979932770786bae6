"""NOVA chips, compiled: what the buses of both generations share: parameters, from the register map, and status bits of a drive."""

from __future__ import annotations

from typing import NamedTuple

from stage.chips.nova.motion import drive, rates
from stage.chips.nova.state import ACCELERATING, AREA_D, AXES, CONSTANT, DECELERATING, REGISTERS
from stage.chips.register_map import RegisterMap
from stage.native import hot


class Parameters(NamedTuple):
    """Bit k of the first three: command code k writes a parameter; it has a sign; it has 16 bits. Values after a reset by code."""

    writes: int
    signed: int
    short: int
    places: tuple[int, ...]
    values: tuple[int, ...]


def parameters(map_: RegisterMap) -> Parameters:
    """Return the parameters of a chip's map."""
    registers = [r for r in map_.registers if r.number < REGISTERS]
    after_reset = [r for r in registers if r.reset]
    return Parameters(
        sum(1 << c.code for c in map_.commands if c.kind == "data write" and c.code < REGISTERS),
        sum(1 << r.number for r in registers if r.signed),
        sum(1 << r.number for r in registers if r.bits == 16),
        tuple(r.number for r in after_reset),
        tuple(r.reset or 0 for r in after_reset),
    )


@hot
def meant(word, signed, short):
    """The number that a parameter's data mean: 32 bits, or the lower 16."""
    bits = 16 if short else 32
    word &= (1 << bits) - 1
    return word - (1 << bits) if signed and word >> (bits - 1) else word


@hot
def lowest(c):
    """The lowest selected axis: it answers."""
    for j in range(AXES):
        if c.selected >> j & 1:
            return j
    return 0


@hot
def busy(x):
    """n-DRV."""
    return x.driving or x.waiting or x.home or x.interpolates


@hot
def phase_bits(c, x):
    """ASND, CNST, DSND, AASND, ACNST, ADSND as bits 0 to 5."""
    if not rates.runs(x):
        return 0
    n = c.clock - x.origin
    phase = drive.phase_at(x, n)
    if phase in (CONSTANT, AREA_D):
        return 2
    if phase != ACCELERATING and phase != DECELERATING:
        return 0
    bits = 1 if phase == ACCELERATING else 4
    if not x.curved:
        return bits | 16
    j6 = x.j6[drive.piece_at(x, n), 0]
    if j6 == 0.0:
        return bits | 16
    return bits | (8 if (j6 > 0.0) == (phase == ACCELERATING) else 32)
