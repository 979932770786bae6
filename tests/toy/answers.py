"""Answers of a core with one defect each, compiled: see defects.py."""

from __future__ import annotations

from stage.chips.cores import through
from stage.native import array_of, exported, least
from toy import core
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
    through(c, row, k + 1, core.run, core.net, core.drive_input)


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
