"""Multichip interpolation of the MCX514 and MCX512, compiled: several chips, wired to each other, make one line.

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
def find_multichip_role(chip, ipm):
    """Return the role of the chip in multichip interpolation by the register IPM: MASTER, SLAVE or 0 for none.

    A master without wires to other chips has no role.

    Args:
        chip: State of the chip.
        ipm: IPM.
    """
    role = ipm >> MLT & 3
    return role if role == SLAVE or (role == MASTER and chip.wire_word) else 0


@hot
def can_take_line(chip, role):
    """Return whether a host can write a line now. A slave whose master has already started gets the error MCERR."""
    if chip.interpolating:
        interpolation.note_refused_segment(chip)
        return False
    chip.multichip_error = 1 if role == SLAVE and chip.wire_word & GO else 0
    return not chip.multichip_error


@hot
def await_linked_start(chip, axis_mask, main_axis, single_stepped, role, tx_has_maximum):
    """Make the line at the head of the queue wait until all linked chips can start.

    Args:
        chip: State of the chip.
        axis_mask: Axes of the line, as bits.
        main_axis: Main axis.
        single_stepped: Whether a host command makes each tick.
        role: MASTER or SLAVE.
        tx_has_maximum: Whether the register TX has the maximum finish point.
    """
    ip = chip.ip
    interpolation.prepare_axes(chip, axis_mask, main_axis, 0, SLAVE if role == SLAVE else single_stepped)
    ip.role, ip.awaits_start, ip.uses_tx, ip.next_tick_clock = role, 1, tx_has_maximum, NEVER
    ip.last_tick_clock = ip.tick_interval = 0
    chip.interpolating, chip.signals_failure, chip.stale = 1, 0, 1
    for j in range(chip.axes):
        chip.ax[j].moves = 0
        if axis_mask >> j & 1:
            chip.ax[j].interpolates = 1
    if role == SLAVE:
        chip.queue[ip.queue_head].decelerates = 0


@hot
def _begin_line(chip):
    """Begin the straight line of a multichip interpolation now; all linked chips begin theirs at this clock."""
    ip, segment = chip.ip, chip.queue[chip.ip.queue_head]
    if not ip.uses_tx:
        segment.tick_count = greatest(segment.tick_count, linked_chips.read_wire_number(chip.wire_word))
    chip.interpolating = ip.awaits_start = 0
    for j in range(chip.axes):
        chip.ax[j].interpolates = 0
    ip.errors_at_start, ip.last_tick_clock = interpolation.collect_axis_errors(chip), chip.clock
    chip.stale = 1
    interpolation.start_interpolation(chip)


@hot
def apply_wire_word(chip, word, process_due_events):
    """Apply a new word from the wires to other chips: start, ticks of the master, end or failure.

    Args:
        chip: State of the chip.
        word: The new word, see stage/chips/linked_chips.py.
        process_due_events: Function that processes the chip's due events.
    """
    ip, old = chip.ip, chip.wire_word
    chip.wire_word = word
    if chip.interpolating and ip.role:
        if ip.awaits_start:
            if word & GO and not word & FAILURE:
                _begin_line(chip)
        elif ip.role == SLAVE:
            _apply_master_ticks(chip, linked_chips.count_new_pulses(word, old), process_due_events)
            if chip.interpolating and not word & (GO | FAILURE):
                interpolation.end_interpolation(chip)
        if chip.interpolating and word & FAILURE:
            chip.multichip_error = 1
            interpolation.end_interpolation(chip)
    if word & FAILURE:
        chip.signals_failure = 0
    if chip.stale:
        process_due_events(chip)


@hot
def _apply_master_ticks(chip, tick_count, process_due_events):
    """Make the ticks of the interpolation that the master has sent to this slave.

    Args:
        chip: State of the chip.
        tick_count: Number of ticks.
        process_due_events: Function that processes the chip's due events.
    """
    ip = chip.ip
    for _ in range(tick_count):
        if chip.interpolating:
            if chip.clock > ip.last_tick_clock:
                ip.tick_interval, ip.last_tick_clock = chip.clock - ip.last_tick_clock, chip.clock
            interpolation.begin_interpolation_tick(chip)
            if chip.stale:
                process_due_events(chip)


@hot
def compute_wire_output(chip):
    """Compute the word that the chip drives onto the wires to other chips."""
    levels = FAILURE if chip.signals_failure else 0
    longest = 0
    if chip.interpolating and chip.ip.role:
        levels |= GO if chip.ip.role == MASTER else 0
        longest = chip.queue[chip.ip.queue_head].tick_count
    return linked_chips.pack_wire_word(levels, longest, chip.master_ticks)


@hot
def find_wire_change(chip):
    """Return the clock up to which the word that the chip drives onto the wires to other chips does not change."""
    if not (chip.interpolating and chip.ip.role):
        return NEVER
    return chip.quiet_until if chip.quiet_until < chip.ip.next_tick_clock else chip.ip.next_tick_clock
