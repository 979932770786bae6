"""NOVA MCX514 and MCX512, compiled: one line by several chips, which their wires join (see stage/chips/links.py).

Each chip that takes part interpolates its own axes, against the one largest finish point of all of them; the master's main axis
makes the ticks, and the wires take them to the slaves, at their clock. The sheets' public text names the parts (IPM bits 11 and
10, commands 60h and 7Ch, MCERR), and nothing more: what is here is what they need (inferred).

- A command 60h to 63h to a slave, or to a master that has wires, waits. As soon as a master waits the wires say GO, with the
  largest finish point; all that wait take it, and begin at that clock. So slaves are commanded first.
- A slave that comes too late is refused, MCERR.
- What stops a slave, be it a limit, an error or the host, stops all of them at that clock, and is MCERR to the others; so is an
  error of the master. A master that stops without an error, at once or by a ramp, ends all of them, and is none.
"""

from __future__ import annotations

from stage.chips import links
from stage.chips.nova.interpolation import run as interpolation
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import MASTER, NEVER, SLAVE
from stage.native import greatest, hot

GO, FAILURE = 2, 4  # levels on the wires
MLT = MCX514_MAP.bit("IPM", "MLT")
MCERR = MCX514_MAP.mask("RR3-1", "MCERR")


@hot
def role_of(c, word):
    """Return the role that IPM gives the chip: a master without wires is by itself."""
    role = word >> MLT & 3
    return role if role == SLAVE or (role == MASTER and c.heard) else 0


@hot
def may_take(c, role):
    """A line can be written now; a slave that comes after its master's start is told."""
    if c.interpolating:
        interpolation.refuse(c)
        return False
    c.failed = 1 if role == SLAVE and c.heard & GO else 0
    return not c.failed


@hot
def wait(c, mask, main, stepped, role, fixed):
    """The line at the head of the queue waits for the start of all."""
    ip = c.ip
    interpolation.prepare(c, mask, main, 0, SLAVE if role == SLAVE else stepped)
    ip.role, ip.waits, ip.fixed, ip.due = role, 1, fixed, NEVER
    ip.beat = ip.gap = 0
    c.interpolating, c.fails, c.stale = 1, 0, 1
    for j in range(c.axes):
        c.ax[j].moves = 0
        if mask >> j & 1:
            c.ax[j].interpolates = 1
    if role == SLAVE:
        c.queue[ip.head].slows = 0


@hot
def _begin(c):
    """All begin."""
    ip, g = c.ip, c.queue[c.ip.head]
    if not ip.fixed:
        g.longest = greatest(g.longest, links.number(c.heard))
    c.interpolating = ip.waits = 0
    for j in range(c.axes):
        c.ax[j].interpolates = 0
    ip.errors, ip.beat = interpolation.errors(c), c.clock
    c.stale = 1
    interpolation.start(c)


@hot
def hear(c, word, settle):
    """Apply a change of the wires.

    Args:
        c: State of the chip.
        word: The new word, see stage/chips/links.py.
        settle: Function that lets the chip do what is due.
    """
    ip, old = c.ip, c.heard
    c.heard = word
    if c.interpolating and ip.role:
        if ip.waits:
            if word & GO and not word & FAILURE:
                _begin(c)
        elif ip.role == SLAVE:
            _ticks(c, links.pulses_since(word, old), settle)
            if c.interpolating and not word & (GO | FAILURE):
                interpolation.end(c)
        if c.interpolating and word & FAILURE:
            c.failed = 1
            interpolation.end(c)
    if word & FAILURE:
        c.fails = 0
    if c.stale:
        settle(c)


@hot
def _ticks(c, count, settle):
    """Ticks of the master come."""
    ip = c.ip
    for _ in range(count):
        if c.interpolating:
            if c.clock > ip.beat:
                ip.gap, ip.beat = c.clock - ip.beat, c.clock
            interpolation.tick(c)
            if c.stale:
                settle(c)


@hot
def says(c):
    """Return what the chip drives onto the wires."""
    levels = FAILURE if c.fails else 0
    longest = 0
    if c.interpolating and c.ip.role:
        levels |= GO if c.ip.role == MASTER else 0
        longest = c.queue[c.ip.head].longest
    return links.share(levels, longest, c.beats)


@hot
def silent(c):
    """The clock up to which that does not change."""
    if not (c.interpolating and c.ip.role):
        return NEVER
    return c.quiet if c.quiet < c.ip.due else c.ip.due
