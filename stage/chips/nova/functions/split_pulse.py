"""NOVA MCX514, compiled: the split pulse, an output that is on for `width` drive pulses in every `cycle` of them.

                     1   2   3   4   5   6   7        drive pulses since 75h
    width 2, cycle 4 |-------|_______|-------|___

It begins with the next drive pulse, whatever drive that belongs to, and ends where the last of SP2 split pulses goes off, or at
76h; each end is a SPLTE. A new SP1 acts from the next cycle on. All of this is inferred.
"""

from __future__ import annotations

from stage.chips.nova.motion.drive import note
from stage.chips.nova.state import NEVER, SP1, SP2, SPLIT_START, SPLTE, SPLTP
from stage.native import greatest, hot, least

ENDLESS = -1


@hot
def start(c, x):
    """75h: anew, also while it runs."""
    x.split, x.split_on = 1, 0
    x.split_rise = x.total + 1
    x.split_left = x.reg[SP2] if x.reg[SP2] else ENDLESS
    x.fired |= SPLIT_START
    c.stale = 1


@hot
def stop(c, x):
    """76h, and the end."""
    if x.split:
        x.split = x.split_on = 0
        note(x, SPLTE)
        c.stale = 1


@hot
def _rise(x):
    """A split pulse begins; SP1 holds for its whole cycle."""
    cycle = greatest(x.reg[SP1] & 0xFFFF, 2)
    width = least(greatest(x.reg[SP1] >> 16 & 0xFFFF, 1), cycle - 1)
    x.split_on = 1
    x.split_fall, x.split_rise = x.split_rise + width, x.split_rise + cycle
    if x.split_left > 0:
        x.split_left -= 1
    note(x, SPLTP)


@hot
def step(c, x):
    if x.split and x.split_on and x.total >= x.split_fall:
        x.split_on = 0
        if x.split_left == 0:
            stop(c, x)
    if x.split and not x.split_on and x.total >= x.split_rise:
        _rise(x)


@hot
def pulses_ahead(x):
    """Drive pulses until the output changes."""
    if not x.split:
        return NEVER
    return (x.split_fall if x.split_on else x.split_rise) - x.total
