"""The sample timer of the HCTL-1100 and its SYNC pin, compiled.

    T T-1 ... 1 0 | T T-1 ...

Each count lasts 16 clocks; the bar is the reload, at which the chip samples.
"""

from __future__ import annotations

from stage.chips.hctl1100.maps import TIMER as T
from stage.chips.hctl1100.state import IDLE, NEVER, SYNC
from stage.native import hot

CLOCKS_PER_COUNT = 16  # clocks


@hot
def start_period(c):
    """Begin to count down from the value that R0F holds."""
    c.period = c.reg[T]
    c.sample_end = c.clock + CLOCKS_PER_COUNT * (c.period + 1)


@hot
def run_idle(c, until):
    """Reload the timer as often as it ends up to `until`. In Init/Idle a sample does nothing else."""
    if until >= c.sample_end:
        c.period = c.reg[T]
        period = CLOCKS_PER_COUNT * (c.period + 1)
        c.sample_end += ((until - c.sample_end) // period + 1) * period


@hot
def skip_samples(c, samples):
    """Let a number of whole periods pass, in which nothing changes."""
    rest = samples * CLOCKS_PER_COUNT * (c.period + 1)
    c.clock += rest
    c.sample_end += rest
    c.computing_until += rest


@hot
def read_timer(c):
    """Return the running count that R0F reads."""
    return 0 if c.timer_stopped else (c.sample_end - 1 - c.clock) // CLOCKS_PER_COUNT


@hot
def apply_sync(c):
    """Stop the timer at 0 while SYNC is asserted in Init/Idle; start it again when the pin or the mode ends."""
    hold = c.mode == IDLE and c.inputs & SYNC
    if hold and not c.timer_stopped:
        c.timer_stopped, c.sample_end = 1, NEVER
    elif c.timer_stopped and not hold:
        c.timer_stopped = 0
        start_period(c)
