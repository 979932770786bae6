"""Compiled microstep sequencer of the TMC5160: MSCNT, the position of the field, and the currents in MSCURACT."""

from __future__ import annotations

from pulsestage_trinamic import common_power_stage
from pulsestage_trinamic.tmc5160.state import (
    GCONF,
    IHOLD_IRUN,
    SHAFT,
    get_step_shift,
)
from stage.native import hot


@hot
def _is_counting_up(c):
    """Return whether the motor's field turns towards greater MSCNT, the sequencer's position."""
    return (c.dir > 0) != ((c.reg[GCONF] & SHAFT) != 0)


@hot
def _compute_position_after(c, steps):
    """Return MSCNT, the sequencer's position, after these steps, without wrapping at 1024."""
    fine, at = get_step_shift(c), c.mscnt
    size = 1 << fine
    half = size >> 1
    if fine == 0:
        return at + steps if _is_counting_up(c) else at - steps
    if _is_counting_up(c):
        return (((at + half) >> fine) << fine) + half + (steps - 1) * size
    return ((-((half - at) >> fine) - 1) << fine) + half - (steps - 1) * size


@hot
def count_steps_to_full_step(c):
    """Return the number of steps until MSCNT >> 8 changes, at least 1."""
    size, first = 1 << get_step_shift(c), _compute_position_after(c, 1)
    if _is_counting_up(c):
        end = ((c.mscnt >> 8) << 8) + 256
        return 1 if first >= end else 1 + (end - first + size - 1) // size
    end = (c.mscnt >> 8) << 8
    return 1 if first < end else 2 + (first - end) // size


@hot
def make_steps(c, steps, clock):
    """Make steps of the microstep sequencer, the last one at `clock`, and raise the current to IRUN."""
    now = _compute_position_after(c, steps)
    c.net += now - c.mscnt
    c.mscnt = now & 1023
    c.toggle ^= steps & 1
    c.last_direction = c.dir
    c.last = clock
    common_power_stage.raise_current(c, c.reg[IHOLD_IRUN])


@hot
def compute_current_word(mscnt):
    """Compute MSCURACT, the currents of both coils by the default microstep table: sine in bits 8..0, cosine in bits 24..16."""
    return _get_table_current(mscnt) & 0x1FF | (_get_table_current(mscnt + 256) & 0x1FF) << 16


@hot
def _get_table_current(mscnt):
    """Return the current of the default microstep table at a microstep count."""
    mscnt &= 1023
    if mscnt >= 512:
        return -_get_table_entry(mscnt - 512) - 1
    return _get_table_entry(mscnt)


@hot
def _get_table_entry(entry):
    """Return entry 0 to 511 of the default microstep table: a half wave of the sine."""
    return SINE_TABLE[511 - entry if entry > 255 else entry]


def _compute_sine_table():
    import math

    entries = []
    for i in range(256):
        value = 248 * math.sin(2 * math.pi * i / 1024 + math.pi / 1024)
        entries.append(max(1, math.floor(value + 0.5)) - 1)
    return tuple(entries)


SINE_TABLE = _compute_sine_table()
