"""Multichip interpolation of the MCX514 and MCX512, compiled: several chips, joined by wires, make one line.

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

from stage.chips import linked_chips
from stage.chips.nova.interpolation import interpolator as interpolation
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import MASTER, NEVER, SLAVE
from stage.native import greatest, hot

GO, FAILURE = 2, 4  # levels on the wires
MLT = MCX514_MAP.bit("IPM", "MLT")
MCERR = MCX514_MAP.mask("RR3-1", "MCERR")


@hot
def find_role(chip, word):
    """Return the role that IPM gives the chip, MASTER, SLAVE or 0. A master without wires has none.

    Args:
        chip: State of the chip.
        word: IPM.
    """
    role = word >> MLT & 3
    return role if role == SLAVE or (role == MASTER and chip.wire_word) else 0


@hot
def can_take_line(chip, role):
    """Return whether a line can be written now. A slave that comes after the start of its master gets MCERR."""
    if chip.interpolating:
        interpolation.note_refused_segment(chip)
        return False
    chip.multichip_error = 1 if role == SLAVE and chip.wire_word & GO else 0
    return not chip.multichip_error


@hot
def await_start(chip, mask, main, stepped, role, fixed):
    """Let the line at the head of the queue wait until all chips can start.

    Args:
        chip: State of the chip.
        mask: Axes of the line, as bits.
        main: Main axis.
        stepped: Whether single steps move it.
        role: MASTER or SLAVE.
        fixed: Whether TX is the maximum finish point.
    """
    ip = chip.ip
    interpolation.prepare_axes(chip, mask, main, 0, SLAVE if role == SLAVE else stepped)
    ip.role, ip.awaits_start, ip.uses_tx, ip.next_tick_clock = role, 1, fixed, NEVER
    ip.last_tick_clock = ip.tick_interval = 0
    chip.interpolating, chip.signals_failure, chip.stale = 1, 0, 1
    for j in range(chip.axes):
        chip.ax[j].moves = 0
        if mask >> j & 1:
            chip.ax[j].interpolates = 1
    if role == SLAVE:
        chip.queue[ip.queue_head].decelerates = 0


@hot
def _begin_line(chip):
    """Begin the straight line now; all linked chips begin theirs at this clock."""
    ip, segment = chip.ip, chip.queue[chip.ip.queue_head]
    if not ip.uses_tx:
        segment.tick_count = greatest(segment.tick_count, linked_chips.read_number(chip.wire_word))
    chip.interpolating = ip.awaits_start = 0
    for j in range(chip.axes):
        chip.ax[j].interpolates = 0
    ip.errors_at_start, ip.last_tick_clock = interpolation.collect_errors(chip), chip.clock
    chip.stale = 1
    interpolation.start_interpolation(chip)


@hot
def apply_wire_word(chip, word, settle):
    """Apply a change of the wires.

    Args:
        chip: State of the chip.
        word: The new word, see stage/chips/linked_chips.py.
        settle: Function that lets the chip do what is due.
    """
    ip, old = chip.ip, chip.wire_word
    chip.wire_word = word
    if chip.interpolating and ip.role:
        if ip.awaits_start:
            if word & GO and not word & FAILURE:
                _begin_line(chip)
        elif ip.role == SLAVE:
            _apply_master_ticks(chip, linked_chips.count_new_pulses(word, old), settle)
            if chip.interpolating and not word & (GO | FAILURE):
                interpolation.end_interpolation(chip)
        if chip.interpolating and word & FAILURE:
            chip.multichip_error = 1
            interpolation.end_interpolation(chip)
    if word & FAILURE:
        chip.signals_failure = 0
    if chip.stale:
        settle(chip)


@hot
def _apply_master_ticks(chip, count, settle):
    """Make the ticks that the master has sent.

    Args:
        chip: State of the chip.
        count: Number of ticks.
        settle: Function that lets the chip do what is due.
    """
    ip = chip.ip
    for _ in range(count):
        if chip.interpolating:
            if chip.clock > ip.last_tick_clock:
                ip.tick_interval, ip.last_tick_clock = chip.clock - ip.last_tick_clock, chip.clock
            interpolation.begin_tick(chip)
            if chip.stale:
                settle(chip)


@hot
def compute_wire_output(chip):
    """Compute the word that the chip drives onto the wires."""
    levels = FAILURE if chip.signals_failure else 0
    longest = 0
    if chip.interpolating and chip.ip.role:
        levels |= GO if chip.ip.role == MASTER else 0
        longest = chip.queue[chip.ip.queue_head].tick_count
    return linked_chips.pack_word(levels, longest, chip.master_ticks)


@hot
def find_wire_change(chip):
    """Return the clock up to which that word does not change."""
    if not (chip.interpolating and chip.ip.role):
        return NEVER
    return chip.quiet_until if chip.quiet_until < chip.ip.next_tick_clock else chip.ip.next_tick_clock
