"""HCTL-2000, HCTL-2016, HCTL-2020, compiled: a counter of quadrature edges behind a latch of two bytes."""

from __future__ import annotations

import numpy as np

from stage.native import array_at, exported, hot, record

STATE = record([(name, "i8") for name in "bits zero latch inhibited".split()])
"""Bits of the counter; the encoder's count at the last reset; the latch, and whether it is inhibited."""
COUNT = np.dtype("i8")


@hot
def _read_counter(state, counts):
    """Return the value of a counter of the HCTL-2016 family from the count of its encoder."""
    return (array_at(counts, 1, COUNT)[0] - state.zero) & (1 << state.bits) - 1


@exported("i8", STATE, "i8", "i8", "i8", "i8", "i8")
def access(state, now, counts, register, kind, value):
    """Read a byte of the counter (port 0: SEL low, the high byte; port 1: SEL high, the low byte); a write to either is /RST."""
    if kind & 1:
        state.zero, state.latch, state.inhibited = array_at(counts, 1, COUNT)[0], 0, 0
        return 0
    if not state.inhibited:
        state.latch = _read_counter(state, counts)
    if register == 0:
        state.inhibited = 1  # both bytes are of one moment
        return state.latch >> 8
    state.inhibited = 0
    return state.latch & 0xFF
