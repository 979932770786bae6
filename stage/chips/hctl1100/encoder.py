"""Encoder input of the HCTL-1100, compiled: the counts of the shaft, and the actual position."""

from __future__ import annotations

import math

from stage.chips.hctl1100.state import NEVER, to_signed
from stage.native import greatest, hot, least

# counts a clock: a state that is shorter than the filter's three clocks does not come through
MAX_FILTERED_RATE = 1.0 / 3.0
MAX_COUNT = float(1 << 53)


@hot
def read_count(chip):
    """Return the raw count of the encoder at the present clock."""
    return _compute_count_at(chip, chip.clock)


@hot
def _compute_count_at(chip, clock):
    """Compute the raw count of the encoder at a clock."""
    x = chip.shaft_count - chip.missed_counts + compute_filtered_rate(chip) * (clock - chip.shaft_clock)
    return int(math.floor(least(greatest(x, -MAX_COUNT), MAX_COUNT)))


@hot
def compute_filtered_rate(chip):
    """Return the rate of the shaft in counts per clock; 0 if the counts come too fast for the input filter."""
    return chip.shaft_rate if abs(chip.shaft_rate) <= MAX_FILTERED_RATE else 0.0


@hot
def set_shaft(chip, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on."""
    chip.missed_counts = compute_missed_counts(chip)
    chip.shaft_clock, chip.shaft_count, chip.shaft_rate = chip.clock, count, rate


@hot
def compute_missed_counts(chip):
    """Return the net number of counts that the input filter has dropped: position of the shaft minus the raw count."""
    missed = chip.missed_counts + (chip.shaft_rate - compute_filtered_rate(chip)) * (chip.clock - chip.shaft_clock)
    return least(greatest(missed, -MAX_COUNT), MAX_COUNT)


@hot
def compute_actual_position(chip):
    """Return the actual position: 24 bits, sign extended."""
    return to_signed(read_count(chip) - chip.position_origin, 24)


@hot
def find_next_count(chip, until):
    """Return the next clock at which the raw count changes, or NEVER if it does not change up to `until`."""
    if compute_filtered_rate(chip) == 0.0:
        return NEVER
    now = read_count(chip)
    if _compute_count_at(chip, until) == now:
        return NEVER
    low, high = chip.clock, until
    while high - low > 1:
        middle = (low + high) // 2
        if _compute_count_at(chip, middle) == now:
            low = middle
        else:
            high = middle
    return high
