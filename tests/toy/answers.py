"""Answers of a core with one defect each, compiled: see defects.py."""

from __future__ import annotations

from stage.chips.cores import run_window
from stage.native import array_of, exported, least
from toy import core, eight
from toy.core import EDGE, MINUS, PLUS, PULSE, STATE


@exported(None, STATE, "i8")
def forgets_the_phase(c, until):
    """Where time is cut, the next pulse is a whole period away."""
    if c.way and c.due <= until:
        n = least(c.left, 1 + (until - c.due) // (c.hz // c.rate))
        c.left -= n
        c.net += n * c.way
        c.due = until + c.hz // c.rate
        if c.left == 0:
            c.way = 0
    c.clock = until


@exported("i8", STATE, "i8")
def forgets_the_phase_too(c, until):
    before = c.net
    forgets_the_phase(c, until)
    return abs(c.net - before)


@exported("i8", STATE, "i8")
def late_by_a_clock(c, until):
    """A pulse that is due at the very end of the time waits for the next piece of time."""
    before = c.net
    core.run(c, until - 1)
    if c.way and c.due == until:
        c.due += 1
        c.clock = until
    else:
        core.run(c, until)
    return abs(c.net - before)


@exported("i8", STATE, "i8")
def one_at_most(c, until):
    before = c.net
    core.run(c, until)
    return 1 if c.net != before else 0


@exported("i8", STATE, "i8", array_of(PULSE))
def the_other_way(c, until, out):
    k = 0
    while c.way and c.due <= until:
        out[k].clock, out[k].axis, out[k].direction = c.due, 0, -c.way
        k += 1
        core.run(c, c.due)
    c.clock = until
    return k


@exported("f8", STATE, "i8", "i8", "f8")
def the_end(c, j, before, ticks):
    return 1.0 * c.net


@exported(None, STATE, "i8", "i8")
def without_the_first_slice(c, row, k):
    run_window(c, row, k + 1, core.run, core.net, core.drive_input)


@exported("i8", STATE, "i8")
def never_busy(c, j):
    return 0


@exported("i8", STATE, "i8")
def counts_twice(c, j):
    return 2 * c.left


@exported(None, STATE)
def keeps_the_rate(c):
    c.left = c.way = c.due = 0


@exported("i8", STATE, "i8")
def clears_what_it_reads(c, address):
    value = core.peek(c, address)
    if address == 2 and not c.way:
        c.left = 0
    return value


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def sees_no_end(c, until, every_pulse, axis, out):
    core.run(c, until)
    return 0


@exported(None, STATE, "i8", "i8")
def takes_all_lines(c, address, value):
    if address == 1:
        c.rate = value
    elif address == 2:
        c.left = value
    else:
        core.write(c, address, PLUS if value == PLUS else MINUS if value == MINUS else 0)


@exported("f8", STATE, "i8", "f8")
def half_the_rate(c, j, hz):
    return 0.5 * core.pulse_rate(c, j, hz)


@exported(None, STATE)
def clears_the_count(c):
    core.power_up(c)
    c.net = 0


@exported("i8", STATE, "i8")
def wider_than_the_bus(c, address):
    return core.peek(c, address) | 0x10000 if c.way else core.peek(c, address)


@exported(None, eight.STATE, "i8")
def leaves_what_is_due_at_the_end(c, until):
    for j in range(eight.AXES):
        x = c.ax[j]
        if x.way == 0 or x.due != until:
            eight.run_axis(c, x, until)
    c.clock = until


@exported("i8", eight.STATE, "i8")
def counts_plus_only(c, until):
    made = 0
    for j in range(eight.AXES):
        before = c.ax[j].net
        eight.run_axis(c, c.ax[j], until)
        made += c.ax[j].net - before if c.ax[j].net > before else 0
    c.clock = until
    return made


@exported(None, eight.STATE, "i8", "i8")
def all_axes_at_once(c, j, word):
    for k in range(eight.AXES):
        eight.set_input(c, k, word)


@exported("i8", eight.STATE, "i8")
def looks_and_touches(c, address):
    """The last axis loses its next pulse."""
    if address == 2 * eight.AXES:
        c.ax[eight.AXES - 1].due += 1
    return eight.peek(c, address)


@exported("i8", eight.STATE, "i8", "i8", "i8", array_of(eight.EDGE))
def sees_pulses_and_no_ends(c, until, every_pulse, axis, out):
    if every_pulse:
        return eight.scan(c, until, every_pulse, axis, out)
    eight.run(c, until)
    return 0


@exported(None, STATE, "i8", "i8")
def only_keeps(c, j, word):
    """The input pins change, and a drive goes on."""
    c.inputs = word


@exported(None, eight.STATE, "i8", "i8")
def stops_all(c, address, value):
    """A stop of any axis is one of all."""
    eight.write(c, address, value)
    if address == 0 and value % 16 not in (PLUS, MINUS):
        for j in range(eight.AXES):
            c.ax[j].way = 0


@exported("i8", eight.STATE, "i8", array_of(PULSE))
def one_a_clock(c, until, out):
    """Of pulses of one clock only one is told."""
    k = eight.trace(c, until, out)
    n = 0
    for m in range(k):
        if n == 0 or out[n - 1].clock != out[m].clock:
            out[n].clock, out[n].axis, out[n].direction = out[m].clock, out[m].axis, out[m].direction
            n += 1
    return n


@exported("i8", STATE, "i8", "i8", "i8", array_of(EDGE))
def one_too_many(c, until, every_pulse, axis, out):
    """Full is when one more has been written."""
    k = core.scan(c, until, every_pulse, axis, out)
    if k >= len(out) - 1:
        core.mark(c, axis, out, len(out))
    return k
