"""Comparators of the NOVA chips, for counters, speed and timer, and the clock at which they next change; compiled.

A comparison that becomes true is an event, whatever the cause: a pulse, an edge of the encoder, time, or a bus write [I].
"""

from __future__ import annotations

from stage.chips.nova.functions import encoder, timer
from stage.chips.nova.functions.inputs import UP_DOWN
from stage.chips.nova.motion import counters, drive, rates
from stage.chips.nova.motion.profile import find_speed_crossing
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import COMP_MINUS, COMP_PLUS, LP, MCX514_TYPE, MR0, MRM, NEVER, RP, RX, SM, SP
from stage.native import hot, least

AT_LP, AT_RP, AT_CV, AT_CT = range(4)
AT_LEAST, ABOVE, EQUAL, BELOW = range(4)
FIRST_CMR = MCX514_MAP.bit("RR1", "CMR0")
MR_COUNT = 4
PULSE, GE_MINUS, LT_MINUS, LT_PLUS, GE_PLUS = MCX304_MAP.masks("RR3", "PULSE", "P>=C-", "P<C-", "P<C+", "P>=C+")


@hot
def _read_source(x, m):
    """Return what MRm is compared with: AT_LP, AT_RP, AT_CV or AT_CT."""
    return x.mode[MRM] >> 4 * m & 3


@hot
def _is_true(c, x, m):
    """Return whether the comparison of MRm is true."""
    kind, condition, than = _read_source(x, m), x.mode[MRM] >> 4 * m + 2 & 3, x.reg[MR0 + m]
    if kind == AT_LP:
        value = x.reg[LP]
    elif kind == AT_RP:
        value = x.reg[RP]
    elif kind == AT_CV:
        value = rates.read_speed(c, x)
    else:
        value = timer.read_timer(c, x)
    if condition == AT_LEAST:
        return value >= than
    if condition == ABOVE:
        return value > than
    return value == than if condition == EQUAL else value < than


@hot
def _find_true_comparisons(c, x):
    """Return the comparisons that are true now, as bits."""
    word = 0
    if c.variant == MCX514_TYPE:
        for m in range(MR_COUNT):
            if _is_true(c, x, m):
                word |= 1 << m
        return word
    counter = counters.read_limited_counter(x)
    word |= GE_MINUS if counter >= x.reg[COMP_MINUS] else LT_MINUS
    return word | (GE_PLUS if counter >= x.reg[COMP_PLUS] else LT_PLUS)


@hot
def reset_comparisons(c, x):
    """Note the comparisons that are true after a reset, so that they are no events."""
    x.comparison_events = 0
    x.true_comparisons = _find_true_comparisons(c, x)


@hot
def update_comparisons(c, x):
    """Note an event for each comparison that has become true."""
    now = _find_true_comparisons(c, x)
    new = now & ~x.true_comparisons
    x.true_comparisons = now
    if new == 0:
        return
    if c.variant == MCX514_TYPE:
        drive.note_event(x, new << FIRST_CMR)
    else:
        x.comparison_events |= new


@hot
def uses_rp(c, x):
    """Return whether a comparison or a software limit uses RP."""
    if c.variant == MCX514_TYPE:
        for m in range(MR_COUNT):
            if _read_source(x, m) == AT_RP:
                return True
    return x.soft_rp != 0


@hot
def _count_pulses_to(counter, direction, value):
    """Return the number of pulses until a counter reaches a value, leaves it, or wraps.

    Args:
        counter: Value of the counter.
        direction: +1 or -1.
        value: Value to compare.
    """
    left = (1 << 31) - counter if direction > 0 else counter + (1 << 31) + 1
    distance = direction * (value - counter)
    return least(left, distance if distance > 0 else 1) if distance >= 0 else left


@hot
def count_pulses_to_change(c, x):
    """Return the number of pulses of the drive until a comparison may change."""
    distance = NEVER
    if c.variant != MCX514_TYPE:
        if not x.soft_rp:
            distance = least(
                _count_pulses_to(x.reg[LP], x.direction, x.reg[COMP_PLUS]),
                _count_pulses_to(x.reg[LP], x.direction, x.reg[COMP_MINUS]),
            )
        return distance
    for m in range(MR_COUNT):
        if _read_source(x, m) == AT_LP:
            distance = least(distance, _count_pulses_to(x.reg[LP], x.direction, x.reg[MR0 + m]))
    return distance


@hot
def _count_to_boundary(counter, direction, boundary, maximum):
    """Return the number of counts until a counter crosses a boundary, in either direction, or wraps.

    Args:
        counter: Value of the counter.
        direction: +1 or -1.
        boundary: Smallest value on the upper side.
        maximum: Value after which the counter wraps to 0, or NO_MAXIMUM.
    """
    if maximum == counters.NO_MAXIMUM:
        over = (1 << 31) - counter if direction > 0 else counter + (1 << 31) + 1
    elif not 0 <= counter <= maximum:
        return 1  # the ring takes it in with the next count
    elif not 0 < boundary <= maximum:
        return NEVER
    else:
        over = maximum + 1 - counter if direction > 0 else counter + 1
    distance = boundary - counter if direction > 0 else counter - boundary + 1
    return least(distance, over) if distance > 0 else over


@hot
def _count_to_rp_change(c, x, direction):
    """Return the number of counts of RP until a comparison or a software limit changes.

    Args:
        c: State of the chip.
        x: State of the axis.
        direction: +1 or -1.
    """
    distance, maximum, counter = NEVER, counters.NO_MAXIMUM, x.reg[RP]
    if c.variant == MCX514_TYPE:
        maximum = x.reg[RX]
        for m in range(MR_COUNT):
            if _read_source(x, m) == AT_RP:
                condition, value = x.mode[MRM] >> 4 * m + 2 & 3, x.reg[MR0 + m]
                if condition != ABOVE:
                    distance = least(distance, _count_to_boundary(counter, direction, value, maximum))
                if condition in (ABOVE, EQUAL):
                    distance = least(distance, _count_to_boundary(counter, direction, value + 1, maximum))
    if x.soft_rp:
        distance = least(
            distance,
            _count_to_boundary(counter, direction, x.reg[SP] + (1 if c.variant == MCX514_TYPE else 0), maximum),
        )
        distance = least(distance, _count_to_boundary(counter, direction, x.reg[SM], maximum))
    return distance


@hot
def find_next_rp_change(c, x):
    """Find the clock at which a comparison or software limit of RP changes if the shaft keeps its rate.

    In the up / down mode RP alternates between two values: if one step changes nothing, no later step does.
    """
    if x.encoder_mode == UP_DOWN:
        direction = encoder.find_up_down_direction(x)
        return encoder.find_next_edge(c, x) if _count_to_rp_change(c, x, direction) == 1 else NEVER
    return encoder.find_clock_of_counts(c, x, _count_to_rp_change(c, x, 1 if encoder.is_counting_up(x) else -1))


@hot
def find_next_change(c, x):
    """Find the clock at which a comparison with the speed or the timer may change."""
    at = NEVER
    if c.variant != MCX514_TYPE:
        return at
    for m in range(MR_COUNT):
        kind, value = _read_source(x, m), x.reg[MR0 + m]
        if kind == AT_CT and x.timer_end:
            at = least(at, least(timer.find_clock_of_count(c, x, value), timer.find_clock_of_count(c, x, value + 1)))
        elif kind == AT_CV and x.driving:
            n = c.clock - x.origin
            passes = least(find_speed_crossing(x, n, value), find_speed_crossing(x, n, value + 1))
            if passes < NEVER:
                at = least(at, x.origin + passes)
    return at
