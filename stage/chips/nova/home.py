"""NOVA chips, compiled: the automatic home search."""

from __future__ import annotations

from stage.chips.nova.state import NEVER
from stage.compiled import hot


@hot
def reset(x):
    x.home = x.home_step = x.home_until = 0


@hot
def start(c, x):
    """5Ah, 62h."""


@hot
def end(c, x):
    """A stop command ends the search."""
    x.home = x.home_step = x.home_until = 0


@hot
def step(c, x):
    """What is due at the present clock; sets `stale` where it changes something."""


@hot
def next_event(c, x):
    """The clock of the next event, NEVER if none is coming."""
    return x.home_until if x.home_until else NEVER


@hot
def state304(x):
    """HMST of RR2 of the older chips."""
    return x.home
