"""TMC5160, compiled: the microstep sequencer, and its currents as they can be read."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import power
from pulsestage_trinamic.tmc5160.state import (
    GCONF,
    NEVER,
    RUNS,
    SHAFT,
    mres,
)
from stage.native import hot


@hot
def _up(c):
    """Return whether the field turns towards greater MSCNT."""
    return (c.dir > 0) != ((c.reg[GCONF] & SHAFT) != 0)


@hot
def _stepped(c, k):
    """Return the position of the sequencer after k steps, without wrapping."""
    fine, at = mres(c), c.mscnt
    size = 1 << fine
    half = size >> 1
    if fine == 0:
        return at + k if _up(c) else at - k
    if _up(c):
        return (((at + half) >> fine) << fine) + half + (k - 1) * size
    return ((-((half - at) >> fine) - 1) << fine) + half - (k - 1) * size


@hot
def steps_to_full(c):
    """Return the number of the step, counted from 1, that next changes MSCNT >> 8."""
    size, first = 1 << mres(c), _stepped(c, 1)
    if _up(c):
        end = ((c.mscnt >> 8) << 8) + 256
        return 1 if first >= end else 1 + (end - first + size - 1) // size
    end = (c.mscnt >> 8) << 8
    return 1 if first < end else 2 + (first - end) // size


@hot
def steps(c, k, clock):
    """Make k steps, the last one at `clock`."""
    now = _stepped(c, k)
    c.net += now - c.mscnt
    c.mscnt = now & 1023
    c.toggle ^= k & 1
    c.way = c.dir
    c.last = clock
    if c.current != RUNS:
        c.current, c.falls = RUNS, NEVER
        c.cs = power.irun(c)


@hot
def sine(i):
    """Return CUR_A of the default table at MSCNT = i."""
    i &= 1023
    if i >= 512:
        return -sine_half(i - 512) - 1
    return sine_half(i)


@hot
def sine_half(i):
    """Return the entries 0 to 511 of the default table."""
    return TABLE[511 - i if i > 255 else i]


def _table():
    import math

    found = []
    for i in range(256):
        value = 248 * math.sin(2 * math.pi * i / 1024 + math.pi / 1024)
        found.append(max(1, math.floor(value + 0.5)) - 1)
    return tuple(found)


TABLE = _table()
