"""Compiled functions of a core with one defect each; defects.py builds chips from them."""

from __future__ import annotations

from stage.chips.core_interface import run_slices
from stage.native import array_of, exported, least
from toy import core, eight
from toy.core import EDGE, MINUS, PLUS, PULSE, STATE


@exported(None, STATE, "i8")
def run_restarting_the_period(c, until):
    """Run to a clock and restart the period there, so the next pulse comes a full period later."""
    if c.direction and c.due <= until:
        n = least(c.left, 1 + (until - c.due) // (c.hz // c.rate))
        c.left -= n
        c.net += n * c.direction
        c.due = until + c.hz // c.rate
        if c.left == 0:
            c.direction = 0
    c.clock = until


@exported("i8", STATE, "i8")
def advance_restarting_the_period(c, until):
    before = c.net
    run_restarting_the_period(c, until)
    return abs(c.net - before)


@exported("i8", STATE, "i8")
def advance_deferring_a_pulse_at_the_end(c, until):
    """Advance, but defer a pulse that is due exactly at the end to the next call."""
    before = c.net
    core.run(c, until - 1)
    if c.direction and c.due == until:
        c.due += 1
        c.clock = until
    else:
        core.run(c, until)
    return abs(c.net - before)


@exported("i8", STATE, "i8")
def advance_counting_one_pulse(c, until):
    before = c.net
    core.run(c, until)
    return 1 if c.net != before else 0


@exported("i8", STATE, "i8", array_of(PULSE))
def trace_with_reversed_direction(c, until, out):
    k = 0
    while c.direction and c.due <= until:
        out[k].clock, out[k].axis, out[k].direction = c.due, 0, -c.direction
        k += 1
        core.run(c, c.due)
    c.clock = until
    return k


@exported("f8", STATE, "i8", "i8", "f8")
def drive_input_at_the_end(c, j, before, ticks):
    return 1.0 * c.net


@exported(None, STATE, "i8", "i8")
def window_skipping_the_first_slice(c, row, k):
    run_slices(c, row, k + 1, core.run, core.read_net_count, core.compute_drive_input)


@exported("i8", STATE, "i8")
def busy_always_false(c, j):
    return 0


@exported("i8", STATE, "i8")
def counter_doubled(c, j):
    return 2 * c.left


@exported(None, STATE)
def power_up_keeping_the_rate(c):
    c.left = c.direction = c.due = 0


@exported("i8", STATE, "i8")
def read_clearing_the_count(c, address):
    value = core.peek(c, address)
    if address == 2 and not c.direction:
        c.left = 0
    return value


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_finding_no_edges(c, until, every_pulse, axis, out):
    core.run(c, until)
    return 0


@exported(None, STATE, "i8", "i8")
def write_without_masking(c, address, value):
    if address == 1:
        c.rate = value
    elif address == 2:
        c.left = value
    else:
        core.write(c, address, PLUS if value == PLUS else MINUS if value == MINUS else 0)


@exported("f8", STATE, "i8", "f8")
def pulse_rate_halved(c, j, hz):
    return 0.5 * core.read_pulse_rate(c, j, hz)


@exported(None, STATE)
def power_up_clearing_net(c):
    core.power_up(c)
    c.net = 0


@exported("i8", STATE, "i8")
def read_wider_than_the_bus(c, address):
    return core.peek(c, address) | 0x10000 if c.direction else core.peek(c, address)


@exported(None, eight.STATE, "i8")
def run_omitting_pulses_at_the_end(c, until):
    for j in range(eight.AXES):
        x = c.ax[j]
        if x.direction == 0 or x.due != until:
            eight.run_axis(c, x, until)
    c.clock = until


@exported("i8", eight.STATE, "i8")
def advance_counting_plus_only(c, until):
    pulse_count = 0
    for j in range(eight.AXES):
        before = c.ax[j].net
        eight.run_axis(c, c.ax[j], until)
        pulse_count += c.ax[j].net - before if c.ax[j].net > before else 0
    c.clock = until
    return pulse_count


@exported(None, eight.STATE, "i8", "i8")
def set_input_of_all_axes(c, j, word):
    for k in range(eight.AXES):
        eight.set_input(c, k, word)


@exported("i8", eight.STATE, "i8")
def peek_delaying_the_last_axis(c, address):
    """Read without side effects, except that the next pulse of the last axis comes one clock later."""
    if address == 2 * eight.AXES:
        c.ax[eight.AXES - 1].due += 1
    return eight.peek(c, address)


@exported("i8", eight.STATE, "i8", "i8", "i8", array_of(eight.EDGE))
def scan_omitting_ends_of_moves(c, until, every_pulse, axis, out):
    if every_pulse:
        return eight.scan_edges(c, until, every_pulse, axis, out)
    eight.run(c, until)
    return 0


@exported(None, STATE, "i8", "i8")
def set_input_without_stopping(c, j, word):
    """Set the input pins without stopping a move at a limit."""
    c.inputs = word


@exported(None, eight.STATE, "i8", "i8")
def write_stopping_all_axes(c, address, value):
    """Write a register; a stop command of one axis stops all axes."""
    eight.write(c, address, value)
    if address == 0 and value % 16 not in (PLUS, MINUS):
        for j in range(eight.AXES):
            c.ax[j].direction = 0


@exported("i8", eight.STATE, "i8", array_of(PULSE))
def trace_one_pulse_per_clock(c, until, out):
    """Trace pulses, listing only one of those with the same clock."""
    k = eight.trace_pulses(c, until, out)
    n = 0
    for m in range(k):
        if n == 0 or out[n - 1].clock != out[m].clock:
            out[n].clock, out[n].axis, out[n].direction = out[m].clock, out[m].axis, out[m].direction
            n += 1
    return n


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def scan_beyond_the_array(c, until, every_pulse, axis, out):
    """Scan for edges, writing one edge beyond the array when it is full."""
    k = core.scan_edges(c, until, every_pulse, axis, out)
    if k >= len(out) - 1:
        core.write_present_edge(c, axis, out, len(out))
    return k
