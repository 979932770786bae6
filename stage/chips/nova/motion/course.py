"""NOVA chips, compiled: the course of one axis as a list of changes, for waveforms, lanes and drawings.

A ramp shows as steps of its rate, RAMP in a piece.
"""

from __future__ import annotations

from stage.chips.nova.motion.profile import clock_of, piece_at
from stage.chips.nova.state import CONSTANT, LP
from stage.native import greatest, hot, least

RAMP = 128
ROOM = 8


@hot
def log(c, j, out, k, word, rate):
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
def _step(x, n):
    """The clock after the origin at which the rate of a ramp takes its next step."""
    s = piece_at(x, n)
    if x.kind[s] == CONSTANT or s + 1 >= x.pieces:
        return 1 << 60
    begin = x.from_clock[s]
    step = greatest(1, (x.from_clock[s + 1] - begin) // RAMP)
    return begin + ((n - begin) // step + 1) * step


@hot
def stop_at(c, j, every_pulse, pulse_end, until):
    """Return how far the chip can run so that nothing of axis `j` is missed. pulse_end: the clock at which its present pulse goes
    off."""
    x = c.ax[j]
    if every_pulse and pulse_end > c.clock:
        until = least(until, pulse_end)
    if x.driving:
        until = least(until, x.origin + _step(x, c.clock - x.origin))
        if every_pulse and not (x.fixed and x.done >= x.output):
            until = least(until, x.origin + clock_of(x, x.done + 1))
    return until
