"""The pulses of NOVA drives in the order of their clocks, for traces, and the changes of an axis, for waveforms; compiled.

At a constant speed of a whole number of pulses per second the pulses are evenly spaced, CLOCKS_PER_SECOND / pps clocks apart,
which integers count exactly as Bresenham's algorithm does: `even_rest` is the distance by which the position at the clock of a
pulse exceeds its number, in pulses / CLOCKS_PER_SECOND, rounded down. If it falls below 0 the pulse comes one clock later. So
each pulse has the clock that profile.py would compute.
"""

from __future__ import annotations

from stage.chips.nova.motion import double_double as dd
from stage.chips.nova.motion.profile import (
    CLOCKS_PER_SECOND,
    PLACE_TOLERANCE,
    compute_exact_place,
    find_clock_in_piece,
    find_clock_of_pulse,
    find_piece,
    find_piece_of_pulse,
)
from stage.chips.nova.state import CONSTANT, LP, NEVER
from stage.native import greatest, hot, least

NOT_EVEN = -1  # in place of pps: not a whole number, or a ramp
RATE_STEPS_PER_PIECE = 128  # of its rate, in a piece
EDGE_MARGIN = 8
MAX_TRAIN_CLOCKS = 1 << 38  # clocks; times pps it fits 63 bits


@hot
def log_pulses(c, until, out, first, k):
    """Log the pulses of all drives in progress, ordered by clock, then by axis.

    Args:
        c: State of the chip.
        until: Clock at the end.
        out: PULSE records to fill.
        first: Number of the first record of this stretch of time; other functions may have filled some.
        k: Number of the next free record.

    Returns:
        The number of the next free record.
    """
    begin = k
    for j in range(c.axes):
        x = c.ax[j]
        _clear_prediction(x)
        if x.driving and not x.interpolates:
            _predict_pulse(x, 1)
    while k < len(out):
        a = 0
        for j in range(1, c.axes):
            if c.ax[j].next_pulse_clock < c.ax[a].next_pulse_clock:
                a = j
        x = c.ax[a]
        if x.next_pulse_clock > until:
            break
        if x.even_pps > 0:
            stop = until
            for j in range(c.axes):
                if j != a:
                    stop = least(stop, c.ax[j].next_pulse_clock - (1 if j < a else 0))
            k = _log_even_pulses(x, a, stop, out, k)
        else:
            out[k].clock, out[k].axis, out[k].direction = x.next_pulse_clock, a, x.direction
            k += 1
            _predict_pulse(x, 1)
    for j in range(c.axes):
        _clear_prediction(c.ax[j])
        c.ax[j].next_pulse_clock = 0
    _merge_by_clock(out, first, begin, k)
    return k


@hot
def _clear_prediction(x):
    """Clear the predicted next pulse of an axis."""
    x.logged_pulses = x.next_pulse_piece = x.even_pps = x.even_rest = 0
    x.next_pulse_clock = NEVER


@hot
def _log_even_pulses(x, a, until, out, k):
    """Log the evenly spaced pulses of one axis.

    Args:
        x: State of the axis.
        a: Number of the axis.
        until: Clock at the end.
        out: PULSE records to fill.
        k: Number of the next free record.

    Returns:
        The number of the next free record.
    """
    due, rest, pps, direction = x.next_pulse_clock, x.even_rest, x.even_pps, x.direction
    last = x.origin + x.from_clock[x.next_pulse_piece + 1] if x.next_pulse_piece + 1 < x.pieces else NEVER
    n = 1 + (pps * least(least(until, last) - due, MAX_TRAIN_CLOCKS) + rest) // CLOCKS_PER_SECOND
    n = least(n, len(out) - k)
    if x.fixed:
        n = least(n, x.output_pulses - x.pulses_done - x.logged_pulses + 1)
    period = CLOCKS_PER_SECOND // pps
    part = CLOCKS_PER_SECOND - period * pps
    for i in range(k, k + n):
        e = out[i]
        e.clock, e.axis, e.direction = due, a, direction
        due += period
        rest -= part
        if rest < 0:
            rest += pps
            due += 1
    if due > last or (x.fixed and x.pulses_done + x.logged_pulses + n > x.output_pulses):
        _predict_pulse(x, n)
    else:
        x.logged_pulses, x.next_pulse_clock, x.even_rest = x.logged_pulses + n, due, rest
    return k + n


@hot
def _predict_pulse(x, n):
    """Predict the clock of the pulse that is `n` pulses ahead; NEVER if the drive ends before it."""
    x.logged_pulses += n
    x.next_pulse_clock = NEVER
    k = x.pulses_done + x.logged_pulses
    if x.fixed and k > x.output_pulses:
        return
    s = x.next_pulse_piece
    if s + 1 < x.pieces:
        x.next_pulse_piece = find_piece_of_pulse(x, s, k)
    clock = find_clock_in_piece(x, x.next_pulse_piece, k)
    x.next_pulse_clock = x.origin + clock
    if x.next_pulse_piece != s or x.even_pps != NOT_EVEN:
        _find_even_spacing(x, x.next_pulse_piece, k, clock)


@hot
def _find_even_spacing(x, s, k, clock):
    """Set `even_pps` and `even_rest` if the pulses of a piece are evenly spaced from a pulse on.

    Args:
        x: State of the axis.
        s: Number of the piece.
        k: Number of the pulse.
        clock: Clocks after the origin at which it begins.
    """
    x.even_pps = NOT_EVEN
    if x.a2[s, 0] != 0.0 or x.j6[s, 0] != 0.0 or clock >= NEVER:
        return
    hz = dd.from_integer(CLOCKS_PER_SECOND)
    speed = dd.mul((x.v[s, 0], x.v[s, 1]), hz)
    pps = dd.floor(dd.add(speed, (0.5, 0.0)))
    if pps < 1 or abs(dd.sub(speed, dd.from_integer(pps))[0]) > 1e-29 * pps:
        return
    over = dd.add(
        dd.sub(compute_exact_place(x, s, clock), dd.from_integer(k - x.from_pulse[s])), (PLACE_TOLERANCE, 0.0)
    )
    rest = dd.floor(dd.mul(over, hz))
    x.even_pps = 0
    if 0 <= rest < pps:
        x.even_pps, x.even_rest = pps, rest


@hot
def _merge_by_clock(out, first, middle, end):
    """Merge the records from `middle` to `end` into those from `first` to `middle`. Both parts are ordered by clock, then axis."""
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
        j: Number of the axis.
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
def _find_next_rate_step(x, n):
    """Find the clock after the origin at which the rate of a ramp, shown as steps, takes its next step."""
    s = find_piece(x, n)
    if x.piece_phase[s] == CONSTANT or s + 1 >= x.pieces:
        return 1 << 60
    begin = x.from_clock[s]
    step = greatest(1, (x.from_clock[s + 1] - begin) // RATE_STEPS_PER_PIECE)
    return begin + ((n - begin) // step + 1) * step


@hot
def find_scan_stop(c, j, every_pulse, pulse_end, until):
    """Find the clock up to which a scan can run without missing a change of an axis. A ramp counts as steps of its rate.

    Args:
        c: State of the chip.
        j: Number of the axis.
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
        until = least(until, x.origin + _find_next_rate_step(x, c.clock - x.origin))
        if every_pulse and not (x.fixed and x.pulses_done >= x.output_pulses):
            until = least(until, x.origin + find_clock_of_pulse(x, x.pulses_done + 1))
    return until
