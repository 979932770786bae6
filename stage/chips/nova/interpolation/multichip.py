"""Multichip interpolation of the MCX514 and MCX512: one line by several chips that wires join (stage/chips/links.py); compiled.

Each chip that takes part interpolates its own axes, relative to the largest finish point of all chips. The main axis of the
master makes the ticks, and the wires bring them to the slaves at the same clock. The public text of the sheets only names the
parts (IPM bits 11 and 10, commands 60h and 7Ch, MCERR); the behavior is inferred.

- A command 60h to 63h to a slave, or to a master that has wires, waits. As soon as a master waits, the wires carry GO with the
  largest finish point; all waiting chips take it and begin at that clock. So the host commands the slaves first.
- A slave that is commanded after the start gets MCERR.
- Whatever stops a slave (a limit, an error or the host) stops all chips at that clock, and gives the others MCERR; so does
  an error of the master. A master that stops without an error, at once or by a ramp, ends the line on all without MCERR.
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
def find_role(c, word):
    """Return the role that IPM gives the chip, MASTER, SLAVE or 0. A master without wires has none.

    Args:
        c: State of the chip.
        word: IPM.
    """
    role = word >> MLT & 3
    return role if role == SLAVE or (role == MASTER and c.wire_word) else 0


@hot
def can_take_line(c, role):
    """Return whether a line can be written now. A slave that comes after the start of its master gets MCERR."""
    if c.interpolating:
        interpolation.note_refused_segment(c)
        return False
    c.multichip_error = 1 if role == SLAVE and c.wire_word & GO else 0
    return not c.multichip_error


@hot
def await_start(c, mask, main, stepped, role, fixed):
    """Let the line at the head of the queue wait until all chips can start.

    Args:
        c: State of the chip.
        mask: Axes of the line, as bits.
        main: Main axis.
        stepped: Whether single steps move it.
        role: MASTER or SLAVE.
        fixed: Whether TX is the maximum finish point.
    """
    ip = c.ip
    interpolation.prepare_axes(c, mask, main, 0, SLAVE if role == SLAVE else stepped)
    ip.role, ip.awaits_start, ip.uses_tx, ip.next_tick_clock = role, 1, fixed, NEVER
    ip.last_tick_clock = ip.tick_interval = 0
    c.interpolating, c.signals_failure, c.stale = 1, 0, 1
    for j in range(c.axes):
        c.ax[j].moves = 0
        if mask >> j & 1:
            c.ax[j].interpolates = 1
    if role == SLAVE:
        c.queue[ip.queue_head].decelerates = 0


@hot
def _begin_line(c):
    """Begin the line at the clock at which all chips begin."""
    ip, g = c.ip, c.queue[c.ip.queue_head]
    if not ip.uses_tx:
        g.tick_count = greatest(g.tick_count, links.read_number(c.wire_word))
    c.interpolating = ip.awaits_start = 0
    for j in range(c.axes):
        c.ax[j].interpolates = 0
    ip.errors_at_start, ip.last_tick_clock = interpolation.collect_errors(c), c.clock
    c.stale = 1
    interpolation.start_interpolation(c)


@hot
def apply_wire_word(c, word, settle):
    """Apply a change of the wires.

    Args:
        c: State of the chip.
        word: The new word, see stage/chips/links.py.
        settle: Function that lets the chip do what is due.
    """
    ip, old = c.ip, c.wire_word
    c.wire_word = word
    if c.interpolating and ip.role:
        if ip.awaits_start:
            if word & GO and not word & FAILURE:
                _begin_line(c)
        elif ip.role == SLAVE:
            _apply_master_ticks(c, links.count_new_pulses(word, old), settle)
            if c.interpolating and not word & (GO | FAILURE):
                interpolation.end_interpolation(c)
        if c.interpolating and word & FAILURE:
            c.multichip_error = 1
            interpolation.end_interpolation(c)
    if word & FAILURE:
        c.signals_failure = 0
    if c.stale:
        settle(c)


@hot
def _apply_master_ticks(c, count, settle):
    """Make the ticks that the master has sent.

    Args:
        c: State of the chip.
        count: Number of ticks.
        settle: Function that lets the chip do what is due.
    """
    ip = c.ip
    for _ in range(count):
        if c.interpolating:
            if c.clock > ip.last_tick_clock:
                ip.tick_interval, ip.last_tick_clock = c.clock - ip.last_tick_clock, c.clock
            interpolation.make_tick(c)
            if c.stale:
                settle(c)


@hot
def compute_wire_output(c):
    """Compute the word that the chip drives onto the wires."""
    levels = FAILURE if c.signals_failure else 0
    longest = 0
    if c.interpolating and c.ip.role:
        levels |= GO if c.ip.role == MASTER else 0
        longest = c.queue[c.ip.queue_head].tick_count
    return links.pack_word(levels, longest, c.master_ticks)


@hot
def find_wire_change(c):
    """Return the clock up to which that word does not change."""
    if not (c.interpolating and c.ip.role):
        return NEVER
    return c.quiet_until if c.quiet_until < c.ip.next_tick_clock else c.ip.next_tick_clock
