"""STEP/DIR axis, compiled: the record that holds it, its lines, and how it counts edges.

A rising edge of STEP moves the count by one, in the direction of DIR, if the power stage accepts it. The times between edges are
checked against the timing of the power stage's data sheet; times are in reference clocks.
"""

from __future__ import annotations

import math

from stage.chips.stepdir.maps import MAP
from stage.native import hot, record

STEP, DIR, ENABLE, EL_PLUS, EL_MINUS, ORG, PROBE = (1 << k for k in range(7))
INPUTS = {
    "step": STEP,
    "dir": DIR,
    "enable": ENABLE,
    "el_plus": EL_PLUS,
    "el_minus": EL_MINUS,
    "org": ORG,
    "probe": PROBE,
}
BUSY, UP, DOWN = 1, 2, 4
OUTPUTS = {"busy": BUSY, "up": UP, "down": DOWN}

STEP_HIGH, STEP_LOW, DIR_SETUP, DIR_HOLD, ENABLE_SETUP = range(5)
"""Places of the times that a power stage demands."""
TIMES = 5
NEVER = 1 << 62
HISTORY = 16
"""Accepted edges that are remembered, for the mean count of a slice of a physics step."""
REGISTERS = 16
SEGMENTS = 8
"""Segments of a profile: three of each ramp, one between them, and the end."""

STATE = record(
    [
        ("clock", "i8"),  # reference clocks since power-up
        ("hz", "i8"),  # reference clocks per second
        ("inputs", "i8"),  # INPUTS now; the step timer drives STEP and DIR as a host does
        ("net", "i8"),  # accepted steps since power-up, plus less minus
        ("origin", "i8"),  # `net` at which POSITION is 0
        ("accepted", "i8"),  # number of accepted steps since power-up
        ("history", "i8", (HISTORY,)),  # of the last accepted steps twice the clock, plus 1 for minus
        ("last_step", "i8"),  # direction of the last rising edge, 1 or -1; 0 if it was not accepted
        ("rose", "i8"),  # clock of the last rising edge of STEP
        ("fell", "i8"),  # clock of its last falling edge
        ("turned", "i8"),  # clock of the last change of DIR
        ("enabled", "i8"),  # clock at which ENABLE was asserted last
        # what the power stage is
        ("required", "i8", (TIMES,)),  # shortest allowed times, clocks
        ("drops_edges", "i8"),  # an edge that comes too early is lost
        ("counts_disabled", "i8"),  # steps are counted while ENABLE is not asserted
        ("amplitude", "f8"),  # of the phase current while ENABLE is asserted, A
        ("violations", "i8", (TIMES,)),  # number of times that were too short
        ("shortest", "i8", (TIMES,)),  # shortest of them, clocks
        ("first_violation", "i8", (TIMES,)),  # clock of the first of them
        # the step timer
        ("reg", "i8", (REGISTERS,)),  # registers at their addresses
        ("control", "i8"),  # control word of the move in progress, or of the last one
        ("running", "i8"),  # a move is in progress
        ("slowing", "i8"),  # a stop with the ramp down was commanded
        ("end_reason", "i8"),  # why the last move ended, a value of the status field `end`
        ("events", "i8"),  # steps of the longest axis of the line; 0: no end
        ("steps", "i8"),  # steps of this axis among them
        ("steps_done", "i8"),  # steps of this move so far
        ("started", "i8"),  # clock at which the profile began
        ("next_rise", "i8"),  # clock of the next rising edge, or NEVER
        ("next_fall", "i8"),  # clock of the next falling edge, or NEVER
        ("profile_end", "i8"),  # clock at which the profile ends, or NEVER
        ("segment", "i8"),  # segment of the next edge
        ("segments", "i8"),  # number of segments
        ("begin", "f8", (SEGMENTS,)),  # of each segment the time at its begin, s since `started`
        ("position", "f8", (SEGMENTS,)),  # steps of the longest axis there
        ("rate", "f8", (SEGMENTS,)),  # rate there, pps
        ("acceleration", "f8", (SEGMENTS,)),  # pps/s
        ("jerk", "f8", (SEGMENTS,)),  # pps/s^2, constant in the segment
    ]
)
"""One axis."""

START, RATE, RAMP_UP, RAMP_DOWN, CURVED, STEPS, EVENTS, HIGH, POSITION = (
    MAP.register(name).number
    for name in ("START", "RATE", "UP", "DOWN", "CURVED", "STEPS", "EVENTS", "HIGH", "POSITION")
)


@hot
def to_clocks(c, seconds):
    """Convert a time to the nearest number of reference clocks."""
    return int(math.floor(seconds * c.hz + 0.5))


@hot
def is_long_enough(c, which, clocks):
    """Check a time between two edges, count a violation, and return whether it is as long as the power stage demands."""
    if clocks >= c.required[which]:
        return True
    if c.violations[which] == 0:
        c.first_violation[which] = c.clock
        c.shortest[which] = clocks
    elif clocks < c.shortest[which]:
        c.shortest[which] = clocks
    c.violations[which] += 1
    return False


@hot
def raise_step(c):
    """Take a rising edge of STEP: count a step in the direction of DIR if the power stage accepts it."""
    in_time = is_long_enough(c, STEP_LOW, c.clock - c.fell)
    in_time &= is_long_enough(c, DIR_SETUP, c.clock - c.turned)
    in_time &= is_long_enough(c, ENABLE_SETUP, c.clock - c.enabled)
    c.rose = c.clock
    c.last_step = 0
    if (in_time or not c.drops_edges) and (c.inputs & ENABLE or c.counts_disabled):
        minus = 1 if c.inputs & DIR else 0
        c.last_step = 1 - 2 * minus
        c.net += c.last_step
        c.history[c.accepted % HISTORY] = 2 * c.clock + minus
        c.accepted += 1


@hot
def _undo_step(c):
    """Take the last step back: its edge was too short for the power stage."""
    if c.last_step:
        c.net -= c.last_step
        c.accepted -= 1
        c.last_step = 0


@hot
def lower_step(c):
    """Take a falling edge of STEP."""
    if not is_long_enough(c, STEP_HIGH, c.clock - c.rose) and c.drops_edges:
        _undo_step(c)
    c.fell = c.clock


@hot
def change_lines(c, word):
    """Take new levels of STEP, DIR and ENABLE; a change of DIR or ENABLE comes before an edge of STEP at the same clock."""
    changed = word ^ c.inputs
    if changed & word & ENABLE:
        c.enabled = c.clock
    if changed & DIR:
        if not is_long_enough(c, DIR_HOLD, c.clock - c.rose) and c.drops_edges:
            _undo_step(c)
        c.turned = c.clock
    c.inputs = word
    if changed & word & STEP:
        raise_step(c)
    elif changed & STEP:
        lower_step(c)


@hot
def count_mean(c, before, ticks):
    """Compute the mean of the count over the last `ticks` clocks, which began with the count `before`.

    Of more edges than HISTORY the mean of begin and end is returned.
    """
    weighted, rest, k = 0.0, c.net - before, c.accepted
    while k > 0 and k > c.accepted - HISTORY:
        entry = c.history[(k - 1) % HISTORY]
        since, direction = c.clock - (entry >> 1), 1 - 2 * (entry & 1)
        if since >= ticks:
            return before + rest + weighted / ticks
        weighted += direction * since
        rest -= direction
        k -= 1
    return before + rest + weighted / ticks if k == 0 else 0.5 * (before + c.net)


@hot
def measured_rate(c, hz):
    """Compute the signed rate of the edges of a host from the last two accepted ones, per second; 0 when they have stopped."""
    if c.accepted < 2:
        return 0.0
    last, previous = c.history[(c.accepted - 1) % HISTORY], c.history[(c.accepted - 2) % HISTORY]
    period = (last >> 1) - (previous >> 1)
    if period <= 0 or c.clock - (last >> 1) > 2 * period:
        return 0.0
    return (1.0 if last & 1 == 0 else -1.0) * hz / period
