"""NOVA chips, compiled: the counters of an axis, and the software limits that compare them."""

from __future__ import annotations

from stage.chips.nova import state
from stage.native import hot

OFF = 0xFFFFFFFF
PULSE = 1  # RR3 of the older chips


@hot
def _ring(value, maximum):
    """A counter that counts up to `most` and then from 0 on; 32 bits with a sign where there is no ring."""
    if maximum != OFF:
        return value % (maximum + 1)
    return (value + (1 << 31) & 0xFFFFFFFF) - (1 << 31)


@hot
def count(c, x, n):
    """Count pulses that have begun.

    Args:
        c: State of the chip.
        x: State of the axis.
        n: Number of pulses.
    """
    x.done += n
    x.total += n
    c.total += n
    x.net += x.way * n
    x.compared |= PULSE
    x.reg[state.LP] = _ring(x.reg[state.LP] + x.way * n, x.reg[state.LX] if c.variant == state.MCX514_TYPE else OFF)


@hot
def count_encoder(c, x, n):
    """Count a movement of the encoder.

    Args:
        c: State of the chip.
        x: State of the axis.
        n: Counts, with their sign.
    """
    x.reg[state.RP] = _ring(x.reg[state.RP] + n, x.reg[state.RX] if c.variant == state.MCX514_TYPE else OFF)


@hot
def limited(x):
    """The counter that the software limits look at."""
    return x.reg[state.RP] if x.soft_rp else x.reg[state.LP]


@hot
def beyond(c, x, direction):
    """The software limit of a direction is enabled and passed: MCX514 LP > SP, LP < SM; before it LP >= C+, LP < C-."""
    if direction > 0:
        return x.soft_plus and (
            limited(x) > x.reg[state.SP] if c.variant == state.MCX514_TYPE else limited(x) >= x.reg[state.SP]
        )
    return x.soft_minus and limited(x) < x.reg[state.SM]


@hot
def hardware_limit(x, direction):
    """The limit switch of a direction is asserted."""
    plus = state.LMT_MINUS if x.swaps else state.LMT_PLUS
    minus = state.LMT_PLUS if x.swaps else state.LMT_MINUS
    return x.active & (plus if direction > 0 else minus)
