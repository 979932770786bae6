"""The STEP/DIR axis, compiled: from one edge to the next.

Firmware drives STEP, DIR and ENABLE as input pins. A host without firmware lets the step timer drive STEP and DIR: it writes rates,
ramps and a number of steps, and a start. The steps of a line's shorter axes are spread among those of the longest one by
Bresenham's rule, as firmware for machine tools does it.
"""

from __future__ import annotations

import numpy as np

from stage.chips.cores import SCAN_ROOM, run_window
from stage.chips.stepdir.maps import CONTROL_ADDRESS, DATA_MASK, MAP
from stage.chips.stepdir.profile import find_step, plan_move, plan_stop, ramp_now, rate_now
from stage.chips.stepdir.state import (
    BUSY,
    DIR,
    DOWN,
    EL_MINUS,
    EL_PLUS,
    ENABLE,
    EVENTS,
    HIGH,
    INPUTS,
    NEVER,
    ORG,
    OUTPUTS,
    POSITION,
    RATE,
    REGISTERS,
    STATE,
    STEP,
    STEPS,
    TIMES,
    UP,
    change_lines,
    count_mean,
    measured_rate,
    to_clocks,
)
from stage.native import array_of, exported, greatest, hot, least, record

__all__ = ["INPUTS", "OUTPUTS", "STATE"]

GO, MINUS, CONTINUOUS, UNTIL_ORG, SLOW, AT_ONCE = MAP.masks(
    "control", "start", "minus", "continuous", "until_org", "ramp_down", "at_once"
)
END = MAP.field("status", "end").low
ALL_STEPS, END_EL_PLUS, END_EL_MINUS, END_ORG, STOPPED = 1, 2, 3, 4, 5
PINS_SHIFT = MAP.field("status", "plus_limit").low
HIGH_NS = MAP.register("HIGH").reset
MARKED_CHANGE = 0.01
"""Share of RATE by which the rate changes between two edges of a course."""

PULSE = np.dtype((np.record, np.dtype([("clock", "i8"), ("axis", "i1"), ("direction", "i1")], align=True)))
EDGE = record([(name, "i8") for name in "clock inputs outputs counter net".split()] + [("rate", "f8")])


@hot
def _schedule_rise(c):
    """Find the clock of the next rising edge: STEP has been low as long as it was high."""
    if c.events and c.steps_done >= c.steps:
        c.next_rise = NEVER
        return
    event = c.steps_done + 1
    if c.events > c.steps:  # Bresenham: step k comes with event ceil((k events - events // 2) / steps)
        event = -((c.events // 2 - event * c.events) // c.steps)
    at = find_step(c, event - 0.5)
    c.next_rise = NEVER if at == NEVER else greatest(at, greatest(c.rose + 2 * _high(c), c.clock + 1))


@hot
def _high(c):
    """Return the clocks that STEP stays high."""
    return greatest(1, to_clocks(c, 1e-9 * c.reg[HIGH]))


@hot
def _end_move(c, reason):
    """End the move at once; a pulse in progress is finished."""
    c.running = c.slowing = 0
    c.next_rise = c.profile_end = NEVER
    c.end_reason = reason


@hot
def _limit_ahead(c):
    """Return the reason of an end limit that blocks the direction of the move, or 0."""
    if c.control & MINUS:
        return END_EL_MINUS if c.inputs & EL_MINUS else 0
    return END_EL_PLUS if c.inputs & EL_PLUS else 0


@hot
def _start_move(c, word):
    """Begin a move, unless one is in progress, it has no steps or no rate, or a switch ends it before its first step."""
    if c.running or c.reg[RATE] == 0 or (c.reg[STEPS] == 0 and not word & CONTINUOUS):
        return
    c.control = word
    reason = _limit_ahead(c)
    if reason == 0 and word & UNTIL_ORG and c.inputs & ORG:
        reason = END_ORG
    if reason:
        _end_move(c, reason)
        return
    change_lines(c, c.inputs | DIR if word & MINUS else c.inputs & ~DIR)
    c.running, c.slowing, c.end_reason, c.steps_done = 1, 0, 0, 0
    c.steps = c.reg[STEPS]
    c.events = 0 if word & CONTINUOUS else greatest(c.steps, c.reg[EVENTS])
    plan_move(c)
    _schedule_rise(c)


@hot
def _slow_down(c, reason):
    """Begin the ramp down; the move ends for this reason."""
    if c.running and not c.slowing:
        c.slowing, c.end_reason = 1, reason
        plan_stop(c)
        _schedule_rise(c)


@hot
def _next_event(c):
    """Return the clock of the next event of the step timer, or NEVER."""
    if c.next_fall != NEVER:
        return least(c.next_fall, c.next_rise)
    if not c.running:
        return NEVER
    return c.next_rise if c.next_rise != NEVER else c.profile_end


@hot
def _do_event(c):
    """Let the event of the present clock happen."""
    if c.clock == c.next_fall:
        c.next_fall = NEVER
        change_lines(c, c.inputs & ~STEP)
    elif c.clock == c.next_rise:
        c.steps_done += 1
        c.next_fall = c.clock + _high(c)
        change_lines(c, c.inputs | STEP)
        _schedule_rise(c)
    else:
        _end_move(c, c.end_reason if c.end_reason else ALL_STEPS)


@hot
def _go_to_event(c, until):
    """Let time pass to the next event or to `until`, and return whether an event happened."""
    at = greatest(_next_event(c), c.clock)
    if at > until:
        c.clock = until
        return False
    c.clock = at
    _do_event(c)
    return True


@exported(None, STATE, "i8")
def run(c, until):
    """Let the clock run up to `until`."""
    while _go_to_event(c, until):
        pass


@exported("i8", STATE, "i8")
def advance(c, until):
    """Let the clock run up to `until`, and return the steps."""
    before = c.accepted
    run(c, until)
    return greatest(0, c.accepted - before)


@exported("i8", STATE, "i8", array_of(PULSE))
def trace(c, until, out):
    """Let the clock run up to `until`, write each step into `out`, and return their number."""
    k, before = 0, c.accepted
    while _go_to_event(c, until):
        if c.accepted > before:
            out[k].clock, out[k].axis, out[k].direction = c.clock, 0, c.last_step
            k += 1
        before = c.accepted
    return k


@exported(None, STATE, "i8", array_of(EDGE), "i8")
def mark(c, axis, out, k):
    """Write the axis as it is now into edge `k`."""
    e = out[k]
    e.clock, e.inputs, e.outputs, e.counter, e.net = c.clock, c.inputs, outputs(c, 0), counter(c, 0), c.net
    e.rate = pulse_rate(c, 0, 1.0)


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan(c, until, every_pulse, axis, out):
    """Let the clock run up to `until` and mark changes of outputs and rate, and each edge of the lines if `every_pulse`."""
    k, word, rate = 0, outputs(c, 0), pulse_rate(c, 0, 1.0)
    while c.clock < until and k < len(out) - SCAN_ROOM:
        if not _go_to_event(c, until):
            break
        now, new = outputs(c, 0), pulse_rate(c, 0, 1.0)
        if every_pulse or now != word or abs(new - rate) > MARKED_CHANGE * c.reg[RATE] / c.hz:
            mark(c, 0, out, k)
            word, rate = now, new
            k += 1
    return k


@exported(None, STATE, "i8", "i8")
def window(c, row, k):
    """Run the slices of a physics step."""
    run_window(c, row, k, run, net, drive_input)


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input(c, j, before, ticks):
    """Return the mean count of the last `ticks` clocks, which began with the count `before`."""
    return count_mean(c, before, ticks)


@exported(None, STATE)
def power_up(c):
    """Clear registers, step timer and violations; lines and switches stay as the host and the stage drive them."""
    for k in range(REGISTERS):
        c.reg[k] = 0
    for k in range(TIMES):
        c.violations[k] = c.shortest[k] = c.first_violation[k] = 0
    c.reg[HIGH] = HIGH_NS
    c.origin = c.net
    c.control = c.events = c.steps = c.steps_done = c.segment = c.segments = 0
    c.last_step = c.started = 0
    c.rose = c.fell = c.turned = c.enabled = -NEVER
    c.next_fall = NEVER
    _end_move(c, 0)


@exported("i8", STATE, "i8")
def peek(c, address):
    """Return what a read would give."""
    if address == CONTROL_ADDRESS:
        return status(c, 0)
    return counter(c, 0) if address == POSITION else c.reg[address]


@exported("i8", STATE, "i8")
def read(c, address):
    """Make a read cycle."""
    return peek(c, address)


@exported(None, STATE, "i8", "i8")
def write(c, address, value):
    """Make a write cycle."""
    if address != CONTROL_ADDRESS:
        if address != POSITION:
            c.reg[address] = value
    elif value & AT_ONCE:
        if c.running:
            _end_move(c, STOPPED)
    elif value & SLOW:
        _slow_down(c, STOPPED)
    elif value & GO:
        _start_move(c, value)


@exported(None, STATE, "i8", "i8")
def set_input(c, j, word):
    """Take new levels of the input pins."""
    reached = word & ~c.inputs & ORG
    change_lines(c, word)
    if not c.running:
        return
    reason = _limit_ahead(c)
    if reason:
        _end_move(c, reason)
    elif c.control & UNTIL_ORG and reached:
        _slow_down(c, END_ORG)


@exported("i8", STATE, "i8")
def inputs(c, j):
    """Return the input pins."""
    return c.inputs


@exported("i8", STATE, "i8")
def outputs(c, j):
    """Return the output pins."""
    if not c.running:
        return 0
    ramp = ramp_now(c)
    return BUSY | (UP if ramp > 0 else DOWN if ramp < 0 else 0)


@exported("i8", STATE, "i8")
def status(c, j):
    """Return the status word."""
    pins = c.inputs // EL_PLUS & 0xF
    return (1 if c.running else 0) | pins << PINS_SHIFT | c.end_reason << END


@exported("i8", STATE, "i8")
def busy(c, j):
    """Return whether the step timer runs."""
    return c.running


@exported("i8", STATE, "i8")
def net(c, j):
    """Return the accepted steps since power-up, plus less minus."""
    return c.net


@exported("i8", STATE, "i8")
def counter(c, j):
    """Return POSITION."""
    return (c.net - c.origin) & DATA_MASK


@exported("f8", STATE, "i8", "f8")
def pulse_rate(c, j, hz):
    """Return the rate at which the count changes now, per second of a clock of `hz`."""
    if not c.running:
        return measured_rate(c, hz)
    share = float(c.steps) / c.events if c.events else 1.0
    return (-1.0 if c.control & MINUS else 1.0) * share * rate_now(c) * hz / c.hz


@exported("f8", STATE, "i8")
def current(c, j):
    """Return the amplitude of the phase currents, A: none while ENABLE is not asserted."""
    return c.amplitude if c.inputs & ENABLE else 0.0


@exported(None, STATE, "i8", "f8", "f8")
def set_shaft(c, j, count, rate):
    """Do nothing: the axis has no input for an encoder."""
