"""NOVA chips, compiled: the pulses of drives in the order of their clocks, for a trace; the changes of an axis, for waveforms.

At a constant speed of a whole number of pps the next pulse is HZ / pps clocks later: that is counted in whole numbers, as in
Bresenham's line. `rest` is what the position at the clock of a pulse is ahead of it, in pulses / HZ, rounded down; where that has
become less than nothing, the pulse is a clock later. So it falls where profile.py would find it.
"""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile import HZ, SNAP, clock_in, clock_of, exactly, piece_at, piece_of
from stage.chips.nova.state import CONSTANT, LP, NEVER
from stage.native import greatest, hot, least

UNEVEN = -1  # in place of pps: not a whole number, or a ramp
STEPS_OF_RAMP = 128  # of its rate, in a piece
ROOM = 8
LONG = 1 << 38  # clocks; times pps it fits 63 bits


@hot
def log(c, until, out, first, k):
    """Log the pulses that the drives in progress begin, by clock, then axis.

    Args:
        c: State of the chip.
        until: Clock at the end.
        out: PULSE records.
        first: First of the records that are in use.
        k: Next free record.

    Returns:
        The next free record.
    """
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


@hot
def write_edge(c, j, out, k, word, rate):
    """Write the present state of an axis into an EDGE record.

    Args:
        c: State of the chip.
        j: Axis.
        out: EDGE records.
        k: Number of the record.
        word: Output pins.
        rate: Pulses per clock.

    Returns:
        k + 1.
    """
    e, x = out[k], c.ax[j]
    e.clock, e.inputs, e.outputs, e.counter, e.net = c.clock, x.inputs, word, x.reg[LP], x.net
    e.rate = rate
    return k + 1


@hot
def _next_step(x, n):
    """The clock after the origin at which the rate of a ramp takes its next step."""
    s = piece_at(x, n)
    if x.kind[s] == CONSTANT or s + 1 >= x.pieces:
        return 1 << 60
    begin = x.from_clock[s]
    step = greatest(1, (x.from_clock[s + 1] - begin) // STEPS_OF_RAMP)
    return begin + ((n - begin) // step + 1) * step


@hot
def stop_at(c, j, every_pulse, pulse_end, until):
    """Compute how far the chip can run so that no change of an axis is missed. A ramp shows as steps of its rate.

    Args:
        c: State of the chip.
        j: Axis.
        every_pulse: Include the edges of the pulse output.
        pulse_end: Clock at which the present pulse goes off.
        until: Clock at the end.

    Returns:
        The clock.
    """
    x = c.ax[j]
    if every_pulse and pulse_end > c.clock:
        until = least(until, pulse_end)
    if x.driving:
        until = least(until, x.origin + _next_step(x, c.clock - x.origin))
        if every_pulse and not (x.fixed and x.done >= x.output):
            until = least(until, x.origin + clock_of(x, x.done + 1))
    return until
