"""The shaft of the HCTL-1100 as its encoder counts it, and the actual position; compiled."""

from __future__ import annotations

import math

from stage.chips.hctl1100.state import NEVER, to_signed
from stage.native import greatest, hot, least

MAX_FILTERED_RATE = (
    1.0 / 3.0
)  # counts a clock: a state that is shorter than the filter's three clocks does not come through
MAX_COUNT = float(1 << 53)


@hot
def read_count(c):
    """Return the raw count of the encoder at the present clock."""
    return _compute_count_at(c, c.clock)


@hot
def _compute_count_at(c, clock):
    x = c.shaft_count - c.missed_counts + compute_filtered_rate(c) * (clock - c.shaft_clock)
    return int(math.floor(least(greatest(x, -MAX_COUNT), MAX_COUNT)))


@hot
def compute_filtered_rate(c):
    """Return the rate of the shaft if its counts pass the input filter, in counts per clock; 0 if they come too fast."""
    return c.shaft_rate if abs(c.shaft_rate) <= MAX_FILTERED_RATE else 0.0


@hot
def set_shaft(c, count, rate):
    """Put the shaft at `count + rate * (clock - now)` from now on."""
    c.missed_counts = compute_missed_counts(c)
    c.shaft_clock, c.shaft_count, c.shaft_rate = c.clock, count, rate


@hot
def compute_missed_counts(c):
    """Return the net number of counts that the input filter has dropped: the shaft is so far ahead of the raw count."""
    missed = c.missed_counts + (c.shaft_rate - compute_filtered_rate(c)) * (c.clock - c.shaft_clock)
    return least(greatest(missed, -MAX_COUNT), MAX_COUNT)


@hot
def compute_actual_position(c):
    """Return the actual position: 24 bits, sign extended."""
    return to_signed(read_count(c) - c.position_origin, 24)


@hot
def find_next_count(c, until):
    """Return the next clock at which the raw count changes, or NEVER if it does not change up to `until`."""
    if compute_filtered_rate(c) == 0.0:
        return NEVER
    now = read_count(c)
    if _compute_count_at(c, until) == now:
        return NEVER
    low, high = c.clock, until
    while high - low > 1:
        middle = (low + high) // 2
        if _compute_count_at(c, middle) == now:
            low = middle
        else:
            high = middle
    return high
