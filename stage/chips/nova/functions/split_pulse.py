"""The split pulse of the MCX514, an output that is on for `width` drive pulses in every `cycle` of them; compiled.

                     1   2   3   4   5   6   7        drive pulses since 75h
    width 2, cycle 4 |-------|_______|-------|___

It begins with the next drive pulse of any drive, and ends when the last of SP2 split pulses goes off, or at 76h; both ends are the
event SPLTE. A new SP1 acts from the next cycle on. All of this is inferred.
"""

from __future__ import annotations

from stage.chips.nova.motion.single_axis_drive import note_event
from stage.chips.nova.state import NEVER, SP1, SP2, SPLIT_START, SPLTE, SPLTP
from stage.native import greatest, hot, least

ENDLESS = -1


@hot
def start_split_pulses(chip, axis):
    """Start the split pulses of an axis (command 75h), or start them again."""
    axis.split_running, axis.split_output = 1, 0
    axis.next_split_rise = axis.total + 1
    axis.split_pulses_left = axis.reg[SP2] if axis.reg[SP2] else ENDLESS
    axis.new_events |= SPLIT_START
    chip.stale = 1


@hot
def stop_split_pulses(chip, axis):
    """Stop the split pulses of an axis (command 76h), with the event SPLTE."""
    if axis.split_running:
        axis.split_running = axis.split_output = 0
        note_event(axis, SPLTE)
        chip.stale = 1


@hot
def _begin_split_pulse(axis):
    """Begin one split pulse. A new value of SP1, its cycle and width, takes effect in the next cycle."""
    cycle = greatest(axis.reg[SP1] & 0xFFFF, 2)
    width = least(greatest(axis.reg[SP1] >> 16 & 0xFFFF, 1), cycle - 1)
    axis.split_output = 1
    axis.next_split_fall, axis.next_split_rise = axis.next_split_rise + width, axis.next_split_rise + cycle
    if axis.split_pulses_left > 0:
        axis.split_pulses_left -= 1
    note_event(axis, SPLTP)


@hot
def update_split_pulses(chip, axis):
    """Begin or end split pulses after pulses of the drive have begun."""
    if axis.split_running and axis.split_output and axis.total >= axis.next_split_fall:
        axis.split_output = 0
        if axis.split_pulses_left == 0:
            stop_split_pulses(chip, axis)
    if axis.split_running and not axis.split_output and axis.total >= axis.next_split_rise:
        _begin_split_pulse(axis)


@hot
def count_pulses_to_edge(axis):
    """Return the number of drive pulses until the split pulse output changes."""
    if not axis.split_running:
        return NEVER
    return (axis.next_split_fall if axis.split_output else axis.next_split_rise) - axis.total
