"""An 8-bit output latch with read back, compiled."""

from __future__ import annotations

from stage.native import exported, record

STATE = record([("value", "i8")])


@exported("i8", STATE, "i8", "i8", "i8", "i8", "i8")
def access(state, now, counts, register, kind, value):
    """Write or read back the outputs of an 8-bit output latch in a bus cycle."""
    if kind & 1:
        state.value = value
    return state.value
