"""LS7166, compiled: a counter of 24 bits behind a preset register and an output latch."""

from __future__ import annotations

import numpy as np

from stage.native import array_at, exported, hot, record

STATE = record(
    [(name, "i8") for name in "cntr last pr ol pointer icr occr qr borrows carries compares sign up".split()]
)
"""Counter; the count of the encoder at the last update; preset register, output latch and the pointer to a
byte of both; the control registers; the toggles BWT, CYT, COMPT; the status bits SIGN and UP/DOWN."""
COUNT = np.dtype("i8")
FULL = 1 << 24
ENABLE, DIVIDE = 8, 4


@hot
def _units(s, counts):
    """Return the count of the quadrature inputs in the mode of QR: one, two or all of the four edges of a line."""
    return array_at(counts, 1, COUNT)[0] >> 3 - s.qr if s.qr else 0


@hot
def _update(s, counts):
    """Let the counter count up to now. Between two cycles the net count matters: to and fro cancels out."""
    units = _units(s, counts)
    steps, s.last = units - s.last, units
    if steps == 0 or s.qr == 0 or s.icr & ENABLE == 0:
        return
    s.up = 1 if steps > 0 else 0
    old = s.cntr
    new = old + steps
    s.compares ^= ((new - s.pr) // FULL - (old - s.pr) // FULL) & 1
    s.cntr = new & FULL - 1
    period, times = FULL, 0
    if new >= FULL:
        if s.occr & DIVIDE:
            period = FULL - s.pr
            s.cntr = s.pr + (new - FULL) % period
        times = 1 + (new - FULL) // period
        s.carries, s.sign = s.carries ^ times & 1, 0
    elif new < 0:
        if s.occr & DIVIDE:
            period = s.pr + 1
            s.cntr = s.pr - (-new - 1) % period
        times = 1 + (-new - 1) // period
        s.borrows, s.sign = s.borrows ^ times & 1, 1


@hot
def _master(s, value):
    """Carry out a write to MCR."""
    if value & 0x20:
        s.cntr = s.icr = s.occr = s.qr = s.ol = s.pointer = s.borrows = s.carries = s.compares = s.sign = 0
        s.pr = FULL - 1
        return
    if value & 0x01:
        s.pointer = 0
    if value & 0x02:
        s.ol = s.cntr
    if value & 0x04:
        s.cntr = s.borrows = s.carries = s.sign = 0
    if value & 0x08:
        s.cntr = s.pr
    if value & 0x10:
        s.compares = 0


@hot
def _control(s, counts, value):
    register, value = value >> 6 & 3, value & 0x3F
    if register == 0:
        _master(s, value)
    elif register == 1:
        s.icr = value
        if value & 2:
            s.cntr = s.cntr + 1 & FULL - 1
        if value & 4:
            s.cntr = s.cntr - 1 & FULL - 1
    elif register == 2:
        s.occr = value
    else:
        s.qr = value & 3
    s.last = _units(s, counts)


@exported("i8", STATE, "i8", "i8", "i8", "i8", "i8")
def access(s, now, counts, n, kind, value):
    """Make a cycle at port 0 (C/D low, data) or port 1 (C/D high, control and status)."""
    _update(s, counts)
    at = 8 * s.pointer
    if n == 1:
        if kind & 1:
            _control(s, counts, value)
        return s.borrows | s.carries << 1 | s.compares << 2 | s.sign << 3 | s.up << 4
    s.pointer = (s.pointer + 1) % 3
    if kind & 1:
        s.pr = s.pr & ~(0xFF << at) | value << at
        return 0
    return s.ol >> at & 0xFF
