"""Status bits of a drive of a NOVA chip for its status registers and pins: n-DRV and the phase of its ramp; compiled."""

from __future__ import annotations

from stage.chips.nova.motion import rate_registers, single_axis_drive
from stage.chips.nova.state import ACCELERATING, AREA_D, CONSTANT, DECELERATING
from stage.native import hot


@hot
def is_axis_busy(axis):
    """Return whether the status bit n-DRV is on: the axis drives, waits for INPOS, searches home or interpolates."""
    return axis.driving or axis.awaits_inpos or axis.home_state or axis.interpolates


@hot
def compute_ramp_phase_bits(chip, axis):
    """Compute the status bits of the ramp phase, ASND, CNST, DSND, AASND, ACNST and ADSND, as bits 0 to 5."""
    if not rate_registers.has_profile(axis):
        return 0
    n = chip.clock - axis.origin
    phase = single_axis_drive.find_phase(axis, n)
    if phase in (CONSTANT, AREA_D):
        return 2
    if phase != ACCELERATING and phase != DECELERATING:
        return 0
    bits = 1 if phase == ACCELERATING else 4
    if not axis.curved:
        return bits | 16
    j6 = axis.j6[single_axis_drive.find_piece(axis, n), 0]
    if j6 == 0.0:
        return bits | 16
    return bits | (8 if (j6 > 0.0) == (phase == ACCELERATING) else 32)
