"""NOVA MCX514, compiled: the timer. It counts up from 0, once every 16 clocks, to TM; then once more, or it stops.

Inferred: it counts up; TM holds from the start of a timing to its end; a start while it runs starts anew.
"""

from __future__ import annotations

from stage.chips.nova.motion.drive import note
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import NEVER, TIMER, TM
from stage.native import greatest, hot

CLOCKS = 16  # of one count: a microsecond at 16 MHz
TMMD = MCX514_MAP.mask("WR3", "TMMD")


@hot
def _begin(x, clock):
    x.timer_from, x.timer = clock, clock + CLOCKS * greatest(x.reg[TM], 1)


@hot
def start(c, x):
    """73h: from 0 on, also while it runs."""
    _begin(x, c.clock)
    c.stale = 1


@hot
def stop(c, x):
    """74h."""
    x.timer = 0
    c.stale = 1


@hot
def reading(c, x):
    """CT: counts since the start, 0 while the timer is stopped."""
    return (c.clock - x.timer_from) // CLOCKS if x.timer else 0


@hot
def step(c, x):
    if x.timer and c.clock >= x.timer:
        note(x, TIMER)
        if x.wr[3] & TMMD:
            _begin(x, x.timer)
        else:
            x.timer = 0


@hot
def next_count(c, x, count):
    """The clock at which CT will be `count`, NEVER where it will not before the timer is up."""
    at = x.timer_from + CLOCKS * count
    return at if c.clock < at < x.timer else NEVER


@hot
def next_event(x):
    return x.timer if x.timer else NEVER
