"""NOVA MCX514, compiled: comparators, timer, split pulse, PIO and the synchronous actions."""

from __future__ import annotations

from stage.chips.nova.state import NEVER
from stage.compiled import hot


@hot
def reset(x):
    x.timer = x.split = x.split_at = x.split_left = x.sync = x.dcc = x.compared = 0


@hot
def command(c, x, code):
    """DCC, timer, split pulse, SYNC sets."""


@hot
def timer_reading(c, x):
    return 0


@hot
def status_bits(c, x):
    """RR3 page 1: SYNC0-3 enabled, TIMER, SPLIT."""
    return 0


@hot
def ports(c, first, latch):
    """RR4, RR5: PIO levels of axes `first` and `first` + 1."""
    low, high = c.ax[first], c.ax[first + 1]
    return low.inputs >> 9 & 0xFF | (high.inputs >> 9 & 0xFF) << 8


@hot
def step(c, x):
    """What is due at the present clock; sets `stale` where it changes something."""


@hot
def pulses_ahead(c, x):
    """Pulses of the drive until a comparator or the split pulse cares."""
    return NEVER


@hot
def next_event(c, x):
    """The clock of the next event, NEVER if none is coming."""
    return NEVER
