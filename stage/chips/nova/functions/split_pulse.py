"""The split pulse of the MCX514, an output that is on for `width` drive pulses in every `cycle` of them; compiled.

                     1   2   3   4   5   6   7        drive pulses since 75h
    width 2, cycle 4 |-------|_______|-------|___

It begins with the next drive pulse of any drive, and ends when the last of SP2 split pulses goes off, or at 76h; both ends are the
event SPLTE. A new SP1 acts from the next cycle on. All of this is inferred.
"""

from __future__ import annotations

from stage.chips.nova.motion.drive import note_event
from stage.chips.nova.state import NEVER, SP1, SP2, SPLIT_START, SPLTE, SPLTP
from stage.native import greatest, hot, least

ENDLESS = -1


@hot
def start_split_pulses(c, x):
    """Start the split pulses (75h), or start them again."""
    x.split_running, x.split_output = 1, 0
    x.next_split_rise = x.total + 1
    x.split_pulses_left = x.reg[SP2] if x.reg[SP2] else ENDLESS
    x.new_events |= SPLIT_START
    c.stale = 1


@hot
def stop_split_pulses(c, x):
    """Stop the split pulses (76h), with the event SPLTE."""
    if x.split_running:
        x.split_running = x.split_output = 0
        note_event(x, SPLTE)
        c.stale = 1


@hot
def _begin_split_pulse(x):
    """Begin one split pulse. The present SP1 holds for its whole cycle."""
    cycle = greatest(x.reg[SP1] & 0xFFFF, 2)
    width = least(greatest(x.reg[SP1] >> 16 & 0xFFFF, 1), cycle - 1)
    x.split_output = 1
    x.next_split_fall, x.next_split_rise = x.next_split_rise + width, x.next_split_rise + cycle
    if x.split_pulses_left > 0:
        x.split_pulses_left -= 1
    note_event(x, SPLTP)


@hot
def update_split_pulses(c, x):
    """Do what is due after pulses of the drive have begun."""
    if x.split_running and x.split_output and x.total >= x.next_split_fall:
        x.split_output = 0
        if x.split_pulses_left == 0:
            stop_split_pulses(c, x)
    if x.split_running and not x.split_output and x.total >= x.next_split_rise:
        _begin_split_pulse(x)


@hot
def count_pulses_to_edge(x):
    """Return the number of drive pulses until the output changes."""
    if not x.split_running:
        return NEVER
    return (x.next_split_fall if x.split_output else x.next_split_rise) - x.total
