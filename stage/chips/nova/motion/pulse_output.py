"""Levels of the two pins that carry the pulses of a NOVA axis, PLS (nPP, nPLS, nPA) and DIR (nPM, nDIR, nPB); compiled.

                        PLS                    DIR
    independent         pulses of + drives     pulses of - drives
    pulse and direction pulses                 low in + direction, high in -
    quadrature x4       A                      B                       an edge a pulse; A leads B in + direction
    quadrature x2       A                      B                       two edges a pulse

DP-L (PLS-L) inverts pulses, A and B; DIR-L inverts the direction; DPINV (POINV) exchanges the pins. Inferred: a pulse is on for
half of the period at which it began, one of an interpolation for half of a tick; in quadrature x2 the second edge is where the
pulse goes off; A and B begin a period at a reset.
"""

from __future__ import annotations

from stage.chips.nova.motion.profile_evaluation import compute_speed, find_clock_of_pulse
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import DIR, MCX514_TYPE, PLS
from stage.native import greatest, hot, least

INDEPENDENT, PULSE_AND_DIRECTION, QUADRATURE_X4, QUADRATURE_X2 = range(4)
DPMD = MCX514_MAP.bit("WR3", "DPMD")
DP_L, DIR_L_514, DPINV = MCX514_MAP.masks("WR3", "DP-L", "DIR-L", "DPINV")
PLSMD, POINV = MCX304_MAP.bit("WR2", "PLSMD"), MCX304_MAP.mask("WR3", "POINV")
PLS_L, DIR_L_304 = MCX304_MAP.masks("WR2", "PLS-L", "DIR-L")
MAX_PULSE_CLOCKS = float(1 << 40)


@hot
def compute_pulse_width(rate):
    """Return the width in clocks of a pulse that begins at a rate of `rate` pulses per clock."""
    return greatest(1, int(least(0.5 / rate, MAX_PULSE_CLOCKS))) if rate > 0.0 else 1


@hot
def find_pulse_end(axis):
    """Return the clock at which the last pulse of the axis goes off or has gone off."""
    if not axis.driving or axis.pulses_done <= axis.from_pulse[0]:
        return axis.pulse_off_clock
    n = find_clock_of_pulse(axis, axis.pulses_done)
    return axis.origin + n + compute_pulse_width(compute_speed(axis, n))


@hot
def store_pulse_end(axis):
    """Store the clock at which the axis' present pulse goes off, before the plan that contains it is replaced."""
    axis.pulse_off_clock = find_pulse_end(axis)


@hot
def _read_output_mode(chip, axis):
    """Return the pulse output mode of the axis, INDEPENDENT to QUADRATURE_X2."""
    return axis.wr[3] >> DPMD & 3 if chip.variant == MCX514_TYPE else axis.wr[2] >> PLSMD & 1


@hot
def _exchange_pins(chip, axis, word):
    """Exchange PLS and DIR in a word of output pins if the mode registers say so."""
    inverts = axis.wr[3] & DPINV if chip.variant == MCX514_TYPE else axis.wr[3] & POINV and not chip.extended
    return (PLS if word & DIR else 0) | (DIR if word & PLS else 0) if inverts else word


@hot
def compute_pulse_pins(chip, axis, pulse_on):
    """Compute the levels of PLS and DIR.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        pulse_on: Whether a pulse is on.

    Returns:
        Bits of PLS and DIR, set if the pin is high.
    """
    mode, low = _read_output_mode(chip, axis), axis.wr[3] & DP_L if chip.variant == MCX514_TYPE else axis.wr[2] & PLS_L
    word = 0
    if mode == INDEPENDENT:
        word = (DIR if axis.direction < 0 else PLS) if pulse_on else 0
    elif mode == PULSE_AND_DIRECTION:
        word = PLS if pulse_on else 0
    else:
        edge = axis.net - axis.net_at_reset
        if mode == QUADRATURE_X2:
            edge = 2 * edge - (axis.direction if pulse_on else 0)
        word = (PLS if edge + 1 & 2 else 0) | (DIR if edge & 2 else 0)
    if low:
        word ^= PLS if mode == PULSE_AND_DIRECTION else PLS | DIR
    if mode == PULSE_AND_DIRECTION:
        plus_is_high = axis.wr[3] & DIR_L_514 if chip.variant == MCX514_TYPE else axis.wr[2] & DIR_L_304
        word |= DIR if (axis.direction < 0) != (plus_is_high != 0) else 0
    return _exchange_pins(chip, axis, word)


@hot
def compute_resting_pins(chip, axis):
    """Compute the levels of PLS and DIR without pulses; 0 in the quadrature modes, where only pulses change them."""
    return 0 if _read_output_mode(chip, axis) >= QUADRATURE_X4 else compute_pulse_pins(chip, axis, 0)
