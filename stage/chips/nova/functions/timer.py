"""The timer of the MCX514, which counts from 0 to TM, once every 16 clocks, and then restarts or stops; compiled.

Inferred: it counts up; a new TM acts from the next timing on; a start while it runs begins a new timing.
"""

from __future__ import annotations

from stage.chips.nova.motion.drive import note_event
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import NEVER, TIMER, TM
from stage.native import greatest, hot

CLOCKS_PER_COUNT = 16  # a microsecond at 16 MHz
TMMD = MCX514_MAP.mask("WR3", "TMMD")


@hot
def _begin_timing(x, clock):
    """Begin a timing at a clock."""
    x.timer_start, x.timer_end = clock, clock + CLOCKS_PER_COUNT * greatest(x.reg[TM], 1)


@hot
def start_timer(c, x):
    """Start the timer from 0 (73h), or start it again."""
    _begin_timing(x, c.clock)
    c.stale = 1


@hot
def stop_timer(c, x):
    """Stop the timer (74h)."""
    x.timer_end = 0
    c.stale = 1


@hot
def read_timer(c, x):
    """Return what CT reads: counts since the start, 0 while the timer is stopped."""
    return (c.clock - x.timer_start) // CLOCKS_PER_COUNT if x.timer_end else 0


@hot
def update_timer(c, x):
    """Note the event TIMER if the timer has expired, and restart or stop it as TMMD says."""
    if x.timer_end and c.clock >= x.timer_end:
        note_event(x, TIMER)
        if x.wr[3] & TMMD:
            _begin_timing(x, x.timer_end)
        else:
            x.timer_end = 0


@hot
def find_clock_of_count(c, x, count):
    """Return the clock at which CT will be `count`, NEVER if the timer expires before that."""
    at = x.timer_start + CLOCKS_PER_COUNT * count
    return at if c.clock < at < x.timer_end else NEVER


@hot
def find_timer_end(x):
    """Return the clock at which the timer expires, NEVER while it is stopped."""
    return x.timer_end if x.timer_end else NEVER
