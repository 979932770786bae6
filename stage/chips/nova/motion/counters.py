"""Position counters of an axis of a NOVA chip, and the software limits that are compared with them; compiled."""

from __future__ import annotations

from stage.chips.nova import state
from stage.native import hot

NO_MAXIMUM = 0xFFFFFFFF
PULSE_EVENT = 1  # RR3 of the older chips


@hot
def _wrap_counter(value, maximum):
    """Return the value of a position counter that wraps from `maximum` to 0, or without a maximum at 32 bits with a sign."""
    if maximum != NO_MAXIMUM:
        return value % (maximum + 1)
    return (value + (1 << 31) & 0xFFFFFFFF) - (1 << 31)


@hot
def add_pulses(chip, axis, count):
    """Add pulses that have begun to the logical position counter LP and to the pulse totals.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        count: Number of pulses.
    """
    axis.pulses_done += count
    axis.total += count
    chip.total += count
    axis.net += axis.direction * count
    axis.comparison_events |= PULSE_EVENT
    axis.reg[state.LP] = _wrap_counter(
        axis.reg[state.LP] + axis.direction * count,
        axis.reg[state.LX] if chip.variant == state.MCX514_TYPE else NO_MAXIMUM,
    )


@hot
def add_encoder_counts(chip, axis, count):
    """Add counts of the encoder to the real position counter RP.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        count: Signed number of counts.
    """
    axis.reg[state.RP] = _wrap_counter(
        axis.reg[state.RP] + count, axis.reg[state.RX] if chip.variant == state.MCX514_TYPE else NO_MAXIMUM
    )


@hot
def read_soft_limit_counter(axis):
    """Return the counter that the software limits compare, LP or RP."""
    return axis.reg[state.RP] if axis.soft_rp else axis.reg[state.LP]


@hot
def has_passed_soft_limit(chip, axis, direction):
    """Return whether the software limit of a direction is enabled and passed.

    The MCX514 compares LP > SP and LP < SM, the older chips LP >= C+ and LP < C-.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        direction: +1 or -1.
    """
    if direction > 0:
        return axis.soft_plus and (
            read_soft_limit_counter(axis) > axis.reg[state.SP]
            if chip.variant == state.MCX514_TYPE
            else read_soft_limit_counter(axis) >= axis.reg[state.SP]
        )
    return axis.soft_minus and read_soft_limit_counter(axis) < axis.reg[state.SM]


@hot
def is_limit_asserted(axis, direction):
    """Return whether the limit switch of a direction is asserted.

    Args:
        axis: State of the axis.
        direction: +1 or -1.
    """
    plus = state.LMT_MINUS if axis.limits_swapped else state.LMT_PLUS
    minus = state.LMT_PLUS if axis.limits_swapped else state.LMT_MINUS
    return axis.active_inputs & (plus if direction > 0 else minus)
