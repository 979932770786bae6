"""NOVA chips, compiled: comparisons of counters, speed and timer with registers, and when they next change.

What counts is that a comparison becomes true, by whatever cause: a pulse, an edge of the encoder, time, or a bus write [I].
"""

from __future__ import annotations

from stage.chips.nova.functions import encoder, timer
from stage.chips.nova.functions.inputs import UP_DOWN
from stage.chips.nova.motion import counters, drive, rates
from stage.chips.nova.motion.profile import speed_passes
from stage.chips.nova.registers.mcx300 import MCX304_MAP
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import COMP_MINUS, COMP_PLUS, LP, MCX514_TYPE, MR0, MRM, NEVER, RP, RX, SM, SP
from stage.native import hot, least

AT_LP, AT_RP, AT_CV, AT_CT = range(4)
AT_LEAST, ABOVE, EQUAL, BELOW = range(4)
CMR = MCX514_MAP.bit("RR1", "CMR0")
MRS = 4
PULSE, GE_MINUS, LT_MINUS, LT_PLUS, GE_PLUS = MCX304_MAP.masks("RR3", "PULSE", "P>=C-", "P<C-", "P<C+", "P>=C+")


@hot
def _what(x, m):
    """Return what MRm is compared with."""
    return x.mode[MRM] >> 4 * m & 3


@hot
def _true(c, x, m):
    kind, condition, than = _what(x, m), x.mode[MRM] >> 4 * m + 2 & 3, x.reg[MR0 + m]
    if kind == AT_LP:
        value = x.reg[LP]
    elif kind == AT_RP:
        value = x.reg[RP]
    elif kind == AT_CV:
        value = rates.speed_reading(c, x)
    else:
        value = timer.reading(c, x)
    if condition == AT_LEAST:
        return value >= than
    if condition == ABOVE:
        return value > than
    return value == than if condition == EQUAL else value < than


@hot
def _now(c, x):
    """Return which comparisons hold."""
    word = 0
    if c.variant == MCX514_TYPE:
        for m in range(MRS):
            if _true(c, x, m):
                word |= 1 << m
        return word
    counter = counters.limited(x)
    word |= GE_MINUS if counter >= x.reg[COMP_MINUS] else LT_MINUS
    return word | (GE_PLUS if counter >= x.reg[COMP_PLUS] else LT_PLUS)


@hot
def reset(c, x):
    """Take what holds after a reset as known."""
    x.compared = 0
    x.holds = _now(c, x)


@hot
def step(c, x):
    now = _now(c, x)
    new = now & ~x.holds
    x.holds = now
    if new == 0:
        return
    if c.variant == MCX514_TYPE:
        drive.note(x, new << CMR)
    else:
        x.compared |= new


@hot
def looks_at_rp(c, x):
    """A comparison, or a software limit, looks at RP."""
    if c.variant == MCX514_TYPE:
        for m in range(MRS):
            if _what(x, m) == AT_RP:
                return True
    return x.soft_rp != 0


@hot
def _until(counter, direction, value):
    """Pulses until the counter comes to a value, leaves it, or turns over."""
    left = (1 << 31) - counter if direction > 0 else counter + (1 << 31) + 1
    distance = direction * (value - counter)
    return least(left, distance if distance > 0 else 1) if distance >= 0 else left


@hot
def pulses_ahead(c, x):
    """Pulses of the drive until a comparison may change."""
    distance = NEVER
    if c.variant != MCX514_TYPE:
        if not x.soft_rp:
            distance = least(_until(x.reg[LP], x.way, x.reg[COMP_PLUS]), _until(x.reg[LP], x.way, x.reg[COMP_MINUS]))
        return distance
    for m in range(MRS):
        if _what(x, m) == AT_LP:
            distance = least(distance, _until(x.reg[LP], x.way, x.reg[MR0 + m]))
    return distance


@hot
def _counts_to(counter, direction, boundary, maximum):
    """Return the counts until a counter that goes from `maximum` on to 0 crosses a boundary, from below to it or back, or turns
    over."""
    if maximum == counters.OFF:
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
def _counts_ahead(c, x, direction):
    """Return the counts of RP, up or down, until a comparison or a software limit changes."""
    distance, maximum, counter = NEVER, counters.OFF, x.reg[RP]
    if c.variant == MCX514_TYPE:
        maximum = x.reg[RX]
        for m in range(MRS):
            if _what(x, m) == AT_RP:
                condition, value = x.mode[MRM] >> 4 * m + 2 & 3, x.reg[MR0 + m]
                if condition != ABOVE:
                    distance = least(distance, _counts_to(counter, direction, value, maximum))
                if condition in (ABOVE, EQUAL):
                    distance = least(distance, _counts_to(counter, direction, value + 1, maximum))
    if x.soft_rp:
        distance = least(
            distance, _counts_to(counter, direction, x.reg[SP] + (1 if c.variant == MCX514_TYPE else 0), maximum)
        )
        distance = least(distance, _counts_to(counter, direction, x.reg[SM], maximum))
    return distance


@hot
def next_of_rp(c, x):
    """Return the clock at which a comparison with RP, or a software limit that looks at it, changes while the shaft turns so.

    In the up / down mode RP goes to and fro between two values: where one step changes nothing, none does.
    """
    if x.encoder == UP_DOWN:
        direction = encoder.next_up_down_direction(x)
        return encoder.next_edge(c, x) if _counts_ahead(c, x, direction) == 1 else NEVER
    return encoder.clock_of_counts(c, x, _counts_ahead(c, x, 1 if encoder.counts_up(x) else -1))


@hot
def next_event(c, x):
    """The clock at which a comparison with speed or timer may change."""
    at = NEVER
    if c.variant != MCX514_TYPE:
        return at
    for m in range(MRS):
        kind, value = _what(x, m), x.reg[MR0 + m]
        if kind == AT_CT and x.timer:
            at = least(at, least(timer.next_count(c, x, value), timer.next_count(c, x, value + 1)))
        elif kind == AT_CV and x.driving:
            n = c.clock - x.origin
            passes = least(speed_passes(x, n, value), speed_passes(x, n, value + 1))
            if passes < NEVER:
                at = least(at, x.origin + passes)
    return at
