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
COUNT_MODULUS = 1 << 24
ENABLE, DIVIDE = 8, 4


@hot
def _compute_mode_count(state, counts):
    """Return the count of the quadrature inputs in the mode of QR, which counts one, two or all four edges of an encoder line."""
    return array_at(counts, 1, COUNT)[0] >> 3 - state.qr if state.qr else 0


@hot
def _update_counter(state, counts):
    """Update the LS7166 counter to the present count of its encoder.

    Between two bus cycles only the net count matters.
    """
    units = _compute_mode_count(state, counts)
    steps, state.last = units - state.last, units
    if steps == 0 or state.qr == 0 or state.icr & ENABLE == 0:
        return
    state.up = 1 if steps > 0 else 0
    old = state.cntr
    new = old + steps
    state.compares ^= ((new - state.pr) // COUNT_MODULUS - (old - state.pr) // COUNT_MODULUS) & 1
    state.cntr = new & COUNT_MODULUS - 1
    period, times = COUNT_MODULUS, 0
    if new >= COUNT_MODULUS:
        if state.occr & DIVIDE:
            period = COUNT_MODULUS - state.pr
            state.cntr = state.pr + (new - COUNT_MODULUS) % period
        times = 1 + (new - COUNT_MODULUS) // period
        state.carries, state.sign = state.carries ^ times & 1, 0
    elif new < 0:
        if state.occr & DIVIDE:
            period = state.pr + 1
            state.cntr = state.pr - (-new - 1) % period
        times = 1 + (-new - 1) // period
        state.borrows, state.sign = state.borrows ^ times & 1, 1


@hot
def _write_mcr(state, value):
    """Carry out a write to MCR, the master control register of the LS7166 counter."""
    if value & 0x20:
        state.cntr = state.icr = state.occr = state.qr = state.ol = state.pointer = state.borrows = state.carries = (
            state.compares
        ) = state.sign = 0
        state.pr = COUNT_MODULUS - 1
        return
    if value & 0x01:
        state.pointer = 0
    if value & 0x02:
        state.ol = state.cntr
    if value & 0x04:
        state.cntr = state.borrows = state.carries = state.sign = 0
    if value & 0x08:
        state.cntr = state.pr
    if value & 0x10:
        state.compares = 0


@hot
def _write_control(state, counts, value):
    """Execute a control byte of the LS7166 counter: a write to MCR, ICR, OCCR or QR."""
    register, value = value >> 6 & 3, value & 0x3F
    if register == 0:
        _write_mcr(state, value)
    elif register == 1:
        state.icr = value
        if value & 2:
            state.cntr = state.cntr + 1 & COUNT_MODULUS - 1
        if value & 4:
            state.cntr = state.cntr - 1 & COUNT_MODULUS - 1
    elif register == 2:
        state.occr = value
    else:
        state.qr = value & 3
    state.last = _compute_mode_count(state, counts)


@exported("i8", STATE, "i8", "i8", "i8", "i8", "i8")
def access(state, now, counts, register, kind, value):
    """Execute a bus cycle of the LS7166 counter at port 0 (C/D low, data) or port 1 (C/D high, control and status)."""
    _update_counter(state, counts)
    at = 8 * state.pointer
    if register == 1:
        if kind & 1:
            _write_control(state, counts, value)
        return state.borrows | state.carries << 1 | state.compares << 2 | state.sign << 3 | state.up << 4
    state.pointer = (state.pointer + 1) % 3
    if kind & 1:
        state.pr = state.pr & ~(0xFF << at) | value << at
        return 0
    return state.ol >> at & 0xFF
