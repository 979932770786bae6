"""NOVA chips, compiled: the pulses of drives one by one, in the order of their clocks, for a trace.

At a constant speed of a whole number of pps the next pulse is HZ / pps clocks later: that is counted in whole numbers, as in
Bresenham's line. `rest` is what the position at the clock of a pulse is ahead of it, in pulses / HZ, rounded down; where that has
become less than nothing, the pulse is a clock later. So it falls where profile.py would find it.
"""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile import HZ, SNAP, clock_in, exactly, piece_of
from stage.chips.nova.state import NEVER
from stage.native import hot, least

UNEVEN = -1  # in place of pps: not a whole number, or a ramp
LONG = 1 << 38  # clocks; times pps it fits 63 bits


@hot
def log(c, until, out, first, k):
    """Log the pulses that the drives in progress begin up to `until`, by clock, then axis, among out[first:k]. Returns the
    next k."""
    begin = k
    for j in range(c.axes):
        x = c.ax[j]
        _look_back(x)
        if x.driving and not x.interpolates:
            _foresee(x, 1)
    while k < len(out):
        a = 0
        for j in range(1, c.axes):
            if c.ax[j].due < c.ax[a].due:
                a = j
        x = c.ax[a]
        if x.due > until:
            break
        if x.pps > 0:
            stop = until
            for j in range(c.axes):
                if j != a:
                    stop = least(stop, c.ax[j].due - (1 if j < a else 0))
            k = _train(x, a, stop, out, k)
        else:
            out[k].clock, out[k].axis, out[k].direction = x.due, a, x.way
            k += 1
            _foresee(x, 1)
    for j in range(c.axes):
        _look_back(c.ax[j])
        c.ax[j].due = 0
    _merge(out, first, begin, k)
    return k


@hot
def _look_back(x):
    """No pulse is foreseen."""
    x.ahead = x.at = x.pps = x.rest = 0
    x.due = NEVER


@hot
def _train(x, a, until, out, k):
    """Log the pulses of axis `a` from the one that is due up to `until`, as far as they come evenly. Returns the next k."""
    due, rest, pps, direction = x.due, x.rest, x.pps, x.way
    last = x.origin + x.from_clock[x.at + 1] if x.at + 1 < x.pieces else NEVER
    n = 1 + (pps * least(least(until, last) - due, LONG) + rest) // HZ
    n = least(n, len(out) - k)
    if x.fixed:
        n = least(n, x.output - x.done - x.ahead + 1)
    period = HZ // pps
    part = HZ - period * pps
    for i in range(k, k + n):
        e = out[i]
        e.clock, e.axis, e.direction = due, a, direction
        due += period
        rest -= part
        if rest < 0:
            rest += pps
            due += 1
    if due > last or (x.fixed and x.done + x.ahead + n > x.output):
        _foresee(x, n)
    else:
        x.ahead, x.due, x.rest = x.ahead + n, due, rest
    return k + n


@hot
def _foresee(x, n):
    """The clock of the pulse `n` further ahead, NEVER if the drive is over then."""
    x.ahead += n
    x.due = NEVER
    k = x.done + x.ahead
    if x.fixed and k > x.output:
        return
    s = x.at
    if s + 1 < x.pieces:
        x.at = piece_of(x, s, k)
    clock = clock_in(x, x.at, k)
    x.due = x.origin + clock
    if x.at != s or x.pps != UNEVEN:
        _even(x, x.at, k, clock)


@hot
def _even(x, s, k, clock):
    """Set `pps` and `rest` if the pulses of piece `s` come evenly from the k-th on, which begins at this clock."""
    x.pps = UNEVEN
    if x.a2[s, 0] != 0.0 or x.j6[s, 0] != 0.0 or clock >= NEVER:
        return
    hz = dd.from_integer(HZ)
    speed = dd.mul((x.v[s, 0], x.v[s, 1]), hz)
    pps = dd.floor(dd.add(speed, (0.5, 0.0)))
    if pps < 1 or abs(dd.sub(speed, dd.from_integer(pps))[0]) > 1e-29 * pps:
        return
    over = dd.add(dd.sub(exactly(x, s, clock), dd.from_integer(k - x.from_pulse[s])), (SNAP, 0.0))
    rest = dd.floor(dd.mul(over, hz))
    x.pps = 0
    if 0 <= rest < pps:
        x.pps, x.rest = pps, rest


@hot
def _merge(out, first, middle, end):
    """Put out[middle:end], in order, among out[first:middle], in order: by clock, then axis."""
    if first == middle or middle == end:
        return
    for k in range(middle, end):
        clock, axis, direction = out[k].clock, out[k].axis, out[k].direction
        at = k
        while at > first and (out[at - 1].clock > clock or (out[at - 1].clock == clock and out[at - 1].axis > axis)):
            out[at].clock, out[at].axis, out[at].direction = out[at - 1].clock, out[at - 1].axis, out[at - 1].direction
            at -= 1
        out[at].clock, out[at].axis, out[at].direction = clock, axis, direction
