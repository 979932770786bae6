"""Comparators of the NOVA chips, for counters, speed and timer, and the clock at which they next change; compiled.

A comparison that becomes true is an event, whatever the cause: a pulse, an edge of the encoder, time, or a bus write [I].
"""

from __future__ import annotations

from stage.chips.nova.functions import encoder, timer
from stage.chips.nova.functions.input_pins import UP_DOWN
from stage.chips.nova.motion import counters, rate_registers, single_axis_drive
from stage.chips.nova.motion.profile_evaluation import find_speed_crossing
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
def _read_compared_source(axis, set_index):
    """Return the quantity with which register MR `set_index` is compared: AT_LP, AT_RP, AT_CV or AT_CT."""
    return axis.mode[MRM] >> 4 * set_index & 3


@hot
def _is_comparison_true(chip, axis, set_index):
    """Return whether the comparison with register MR `set_index` is true."""
    kind = _read_compared_source(axis, set_index)
    condition = axis.mode[MRM] >> 4 * set_index + 2 & 3
    than = axis.reg[MR0 + set_index]
    if kind == AT_LP:
        value = axis.reg[LP]
    elif kind == AT_RP:
        value = axis.reg[RP]
    elif kind == AT_CV:
        value = rate_registers.read_speed(chip, axis)
    else:
        value = timer.read_timer(chip, axis)
    if condition == AT_LEAST:
        return value >= than
    if condition == ABOVE:
        return value > than
    return value == than if condition == EQUAL else value < than


@hot
def _find_true_comparisons(chip, axis):
    """Return the comparisons of an axis that are true now, as bits."""
    word = 0
    if chip.variant == MCX514_TYPE:
        for m in range(MR_COUNT):
            if _is_comparison_true(chip, axis, m):
                word |= 1 << m
        return word
    counter = counters.read_soft_limit_counter(axis)
    word |= GE_MINUS if counter >= axis.reg[COMP_MINUS] else LT_MINUS
    return word | (GE_PLUS if counter >= axis.reg[COMP_PLUS] else LT_PLUS)


@hot
def reset_comparisons(chip, axis):
    """Note the comparisons of an axis that are true after a reset, so that they do not count as events."""
    axis.comparison_events = 0
    axis.true_comparisons = _find_true_comparisons(chip, axis)


@hot
def update_comparisons(chip, axis):
    """Note an event for each comparison of an axis that has become true."""
    now = _find_true_comparisons(chip, axis)
    new = now & ~axis.true_comparisons
    axis.true_comparisons = now
    if new == 0:
        return
    if chip.variant == MCX514_TYPE:
        single_axis_drive.note_event(axis, new << FIRST_CMR)
    else:
        axis.comparison_events |= new


@hot
def uses_real_position_counter(chip, axis):
    """Return whether a comparison or a software limit uses RP, the real position counter of the encoder."""
    if chip.variant == MCX514_TYPE:
        for m in range(MR_COUNT):
            if _read_compared_source(axis, m) == AT_RP:
                return True
    return axis.soft_rp != 0


@hot
def _count_pulses_to(counter, direction, value):
    """Return the number of pulses after which a counter reaches a value, leaves it, or wraps.

    Args:
        counter: Value of the counter.
        direction: +1 or -1.
        value: Value to compare.
    """
    left = (1 << 31) - counter if direction > 0 else counter + (1 << 31) + 1
    distance = direction * (value - counter)
    return least(left, distance if distance > 0 else 1) if distance >= 0 else left


@hot
def count_pulses_to_change(chip, axis):
    """Return the number of pulses of the axis' drive until a comparison with LP may change."""
    distance = NEVER
    if chip.variant != MCX514_TYPE:
        if not axis.soft_rp:
            distance = least(
                _count_pulses_to(axis.reg[LP], axis.direction, axis.reg[COMP_PLUS]),
                _count_pulses_to(axis.reg[LP], axis.direction, axis.reg[COMP_MINUS]),
            )
        return distance
    for m in range(MR_COUNT):
        if _read_compared_source(axis, m) == AT_LP:
            distance = least(distance, _count_pulses_to(axis.reg[LP], axis.direction, axis.reg[MR0 + m]))
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
def _count_to_rp_comparison_change(chip, axis, direction):
    """Return the number of counts of RP until a comparison or a software limit changes.

    Args:
        chip: State of the chip.
        axis: State of the axis.
        direction: +1 or -1.
    """
    distance, maximum, counter = NEVER, counters.NO_MAXIMUM, axis.reg[RP]
    if chip.variant == MCX514_TYPE:
        maximum = axis.reg[RX]
        for m in range(MR_COUNT):
            if _read_compared_source(axis, m) == AT_RP:
                condition, value = axis.mode[MRM] >> 4 * m + 2 & 3, axis.reg[MR0 + m]
                if condition != ABOVE:
                    distance = least(distance, _count_to_boundary(counter, direction, value, maximum))
                if condition in (ABOVE, EQUAL):
                    distance = least(distance, _count_to_boundary(counter, direction, value + 1, maximum))
    if axis.soft_rp:
        distance = least(
            distance,
            _count_to_boundary(counter, direction, axis.reg[SP] + (1 if chip.variant == MCX514_TYPE else 0), maximum),
        )
        distance = least(distance, _count_to_boundary(counter, direction, axis.reg[SM], maximum))
    return distance


@hot
def find_next_rp_comparison_change(chip, axis):
    """Find the clock at which a comparison or software limit of RP changes if the shaft keeps its rate.

    In the up / down mode RP alternates between two values: if one step changes nothing, no later step does.
    """
    if axis.encoder_mode == UP_DOWN:
        direction = encoder.find_up_down_direction(axis)
        return (
            encoder.find_next_edge(chip, axis) if _count_to_rp_comparison_change(chip, axis, direction) == 1 else NEVER
        )
    return encoder.find_clock_of_counts(
        chip, axis, _count_to_rp_comparison_change(chip, axis, 1 if encoder.is_counting_up(axis) else -1)
    )


@hot
def find_next_speed_or_timer_comparison_change(chip, axis):
    """Find the clock at which a comparison of an MR register with the speed or the timer may change."""
    at = NEVER
    if chip.variant != MCX514_TYPE:
        return at
    for m in range(MR_COUNT):
        kind, value = _read_compared_source(axis, m), axis.reg[MR0 + m]
        if kind == AT_CT and axis.timer_end:
            at = least(
                at,
                least(timer.find_clock_of_count(chip, axis, value), timer.find_clock_of_count(chip, axis, value + 1)),
            )
        elif kind == AT_CV and axis.driving:
            n = chip.clock - axis.origin
            passes = least(find_speed_crossing(axis, n, value), find_speed_crossing(axis, n, value + 1))
            if passes < NEVER:
                at = least(at, axis.origin + passes)
    return at
