"""The counters of an axis of a NOVA chip, and the software limits that compare them; compiled."""

from __future__ import annotations

from stage.chips.nova import state
from stage.native import hot

NO_MAXIMUM = 0xFFFFFFFF
PULSE = 1  # RR3 of the older chips


@hot
def _wrap_counter(value, maximum):
    """Return the value of a counter that wraps from `maximum` to 0, or at 32 bits with a sign if it has no maximum."""
    if maximum != NO_MAXIMUM:
        return value % (maximum + 1)
    return (value + (1 << 31) & 0xFFFFFFFF) - (1 << 31)


@hot
def add_pulses(c, x, n):
    """Count pulses that have begun.

    Args:
        c: State of the chip.
        x: State of the axis.
        n: Number of pulses.
    """
    x.pulses_done += n
    x.total += n
    c.total += n
    x.net += x.direction * n
    x.comparison_events |= PULSE
    x.reg[state.LP] = _wrap_counter(
        x.reg[state.LP] + x.direction * n, x.reg[state.LX] if c.variant == state.MCX514_TYPE else NO_MAXIMUM
    )


@hot
def add_encoder_counts(c, x, n):
    """Count a movement of the encoder.

    Args:
        c: State of the chip.
        x: State of the axis.
        n: Counts, with their sign.
    """
    x.reg[state.RP] = _wrap_counter(
        x.reg[state.RP] + n, x.reg[state.RX] if c.variant == state.MCX514_TYPE else NO_MAXIMUM
    )


@hot
def read_limited_counter(x):
    """Return the counter that the software limits compare, LP or RP."""
    return x.reg[state.RP] if x.soft_rp else x.reg[state.LP]


@hot
def has_passed_soft_limit(c, x, direction):
    """Return whether the software limit of a direction is enabled and passed.

    The MCX514 compares LP > SP and LP < SM, the older chips LP >= C+ and LP < C-.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.
    """
    if direction > 0:
        return x.soft_plus and (
            read_limited_counter(x) > x.reg[state.SP]
            if c.variant == state.MCX514_TYPE
            else read_limited_counter(x) >= x.reg[state.SP]
        )
    return x.soft_minus and read_limited_counter(x) < x.reg[state.SM]


@hot
def is_limit_asserted(x, direction):
    """Return whether the limit switch of a direction is asserted.

    Args:
        x: State of the axis.
        direction: +1 or -1.
    """
    plus = state.LMT_MINUS if x.limits_swapped else state.LMT_PLUS
    minus = state.LMT_PLUS if x.limits_swapped else state.LMT_MINUS
    return x.active_inputs & (plus if direction > 0 else minus)
