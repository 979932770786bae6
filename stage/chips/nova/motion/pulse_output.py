"""NOVA chips, compiled: the two pins that carry the pulses of an axis, PLS (nPP, nPLS, nPA) and DIR (nPM, nDIR, nPB).

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

from stage.chips.nova.motion.profile import clock_of, speed_at
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import DIR, MCX514_TYPE, PLS
from stage.native import greatest, hot, least

INDEPENDENT, PULSE_AND_DIRECTION, QUADRATURE_X4, QUADRATURE_X2 = range(4)
DPMD = MCX514_MAP.bit("WR3", "DPMD")
DP_L, DIR_L_514, DPINV = (MCX514_MAP.mask("WR3", name) for name in ("DP-L", "DIR-L", "DPINV"))
PLSMD, POINV = MCX304_MAP.bit("WR2", "PLSMD"), MCX304_MAP.mask("WR3", "POINV")
PLS_L, DIR_L_304 = MCX304_MAP.mask("WR2", "PLS-L"), MCX304_MAP.mask("WR2", "DIR-L")
MAX_PULSE_CLOCKS = float(1 << 40)


@hot
def half_period(rate):
    """Return for how many clocks a pulse is on that begins at `rate` pulses a clock."""
    return greatest(1, int(least(0.5 / rate, MAX_PULSE_CLOCKS))) if rate > 0.0 else 1


@hot
def pulse_end(x):
    """Return the clock at which the pulse that began last goes off, or went off."""
    if not x.driving or x.done <= x.from_pulse[0]:
        return x.high
    n = clock_of(x, x.done)
    return x.origin + n + half_period(speed_at(x, n))


@hot
def keep_pulse(x):
    """Note when the present pulse goes off, before the plan that tells it is given up."""
    x.high = pulse_end(x)


@hot
def _mode(c, x):
    return x.wr[3] >> DPMD & 3 if c.variant == MCX514_TYPE else x.wr[2] >> PLSMD & 1


@hot
def _exchange(c, x, word):
    """Return what the pins show of PLS and DIR: the same, or the one in place of the other."""
    inverts = x.wr[3] & DPINV if c.variant == MCX514_TYPE else x.wr[3] & POINV and not c.extended
    return (PLS if word & DIR else 0) | (DIR if word & PLS else 0) if inverts else word


@hot
def levels(c, x, on):
    """Compute the levels of PLS and DIR.

    Args:
        c: State of the chip.
        x: State of the axis.
        on: Whether a pulse is on.

    Returns:
        Bits of PLS and DIR, set where the pin is high.
    """
    mode, low = _mode(c, x), x.wr[3] & DP_L if c.variant == MCX514_TYPE else x.wr[2] & PLS_L
    word = 0
    if mode == INDEPENDENT:
        word = (DIR if x.way < 0 else PLS) if on else 0
    elif mode == PULSE_AND_DIRECTION:
        word = PLS if on else 0
    else:
        edge = x.net - x.net_at_reset
        if mode == QUADRATURE_X2:
            edge = 2 * edge - (x.way if on else 0)
        word = (PLS if edge + 1 & 2 else 0) | (DIR if edge & 2 else 0)
    if low:
        word ^= PLS if mode == PULSE_AND_DIRECTION else PLS | DIR
    if mode == PULSE_AND_DIRECTION:
        plus_is_high = x.wr[3] & DIR_L_514 if c.variant == MCX514_TYPE else x.wr[2] & DIR_L_304
        word |= DIR if (x.way < 0) != (plus_is_high != 0) else 0
    return _exchange(c, x, word)


@hot
def resting_levels(c, x):
    """Return what of PLS and DIR changes without a pulse."""
    return 0 if _mode(c, x) >= QUADRATURE_X4 else levels(c, x, 0)
