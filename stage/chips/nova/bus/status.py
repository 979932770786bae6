"""NOVA chips, compiled: the state of a drive as status bits and outputs."""

from __future__ import annotations

from stage.chips.nova.motion import drive, rates
from stage.chips.nova.state import ACCELERATING, AREA_D, CONSTANT, DECELERATING
from stage.native import hot


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
