"""HCTL-1100, compiled: the sample timer and the SYNC pin.

    T T-1 ... 1 0 | T T-1 ...

Each count lasts 16 clocks; the bar is the reload, at which the chip samples.
"""

from __future__ import annotations

from stage.chips.hctl1100.maps import TIMER as T
from stage.chips.hctl1100.state import IDLE, NEVER, SYNC
from stage.native import hot

STEP = 16  # clocks


@hot
def start(c):
    """Begin to count down from what R0F was given last."""
    c.period = c.reg[T]
    c.next = c.clock + STEP * (c.period + 1)


@hot
def idle_to(c, until):
    """Reload as often as it comes up to `until`: nothing else happens at a sample of Init/Idle."""
    if until >= c.next:
        c.period = c.reg[T]
        period = STEP * (c.period + 1)
        c.next += ((until - c.next) // period + 1) * period


@hot
def skip(c, samples):
    """The samples of `samples` whole periods have come and gone."""
    rest = samples * STEP * (c.period + 1)
    c.clock += rest
    c.next += rest
    c.computing += rest


@hot
def running_count(c):
    """Return what R0F reads."""
    return 0 if c.held else (c.next - 1 - c.clock) // STEP


@hot
def obey_sync(c):
    """SYNC holds the timer at 0 in Init/Idle; it counts again when the pin, or Init/Idle, ends."""
    hold = c.mode == IDLE and c.inputs & SYNC
    if hold and not c.held:
        c.held, c.next = 1, NEVER
    elif c.held and not hold:
        c.held = 0
        start(c)
