"""The timer of the MCX514, which counts from 0 to TM, once every 16 clocks, and then restarts or stops; compiled.

Inferred: the timer counts up; a new TM takes effect when the timer next starts from 0; a start command while it runs restarts it.
"""

from __future__ import annotations

from stage.chips.nova.motion.single_axis_drive import note_event
from stage.chips.nova.registers.mcx514 import MCX514_MAP
from stage.chips.nova.state import NEVER, TIMER, TM
from stage.native import greatest, hot

CLOCKS_PER_COUNT = 16  # a microsecond at 16 MHz
TMMD = MCX514_MAP.mask("WR3", "TMMD")


@hot
def _start_timer_at(axis, clock):
    """Start the timer of an axis from 0 at a clock."""
    axis.timer_start, axis.timer_end = clock, clock + CLOCKS_PER_COUNT * greatest(axis.reg[TM], 1)


@hot
def start_timer(chip, axis):
    """Start the timer of an axis from 0 (command 73h), or start it again."""
    _start_timer_at(axis, chip.clock)
    chip.stale = 1


@hot
def stop_timer(chip, axis):
    """Stop the timer of an axis (command 74h)."""
    axis.timer_end = 0
    chip.stale = 1


@hot
def read_timer(chip, axis):
    """Return the value of the register CT: counts since the start, 0 while the timer is stopped."""
    return (chip.clock - axis.timer_start) // CLOCKS_PER_COUNT if axis.timer_end else 0


@hot
def update_timer(chip, axis):
    """Note the event TIMER if the timer has expired, and restart or stop it as the mode bit TMMD selects."""
    if axis.timer_end and chip.clock >= axis.timer_end:
        note_event(axis, TIMER)
        if axis.wr[3] & TMMD:
            _start_timer_at(axis, axis.timer_end)
        else:
            axis.timer_end = 0


@hot
def find_clock_of_count(chip, axis, count):
    """Return the clock at which the timer register CT will be `count`, NEVER if the timer expires before that."""
    at = axis.timer_start + CLOCKS_PER_COUNT * count
    return at if chip.clock < at < axis.timer_end else NEVER


@hot
def find_timer_end(axis):
    """Return the clock at which the timer of an axis expires, NEVER while it is stopped."""
    return axis.timer_end if axis.timer_end else NEVER
