"""The sample timer of the HCTL-1100 and its SYNC pin, compiled.

    T T-1 ... 1 0 | T T-1 ...

Each count lasts 16 clocks; the bar is the reload, at which the chip samples.
"""

from __future__ import annotations

from stage.chips.hctl1100.maps import TIMER as T
from stage.chips.hctl1100.state import IDLE, NEVER, SYNC
from stage.native import hot

CLOCKS_PER_COUNT = 16  # clocks


@hot
def start_period(chip):
    """Begin a period of the sample timer: count down from the value that R0F holds."""
    chip.period = chip.reg[T]
    chip.sample_end = chip.clock + CLOCKS_PER_COUNT * (chip.period + 1)


@hot
def run_in_init_idle(chip, until):
    """Reload the sample timer at each end of its period up to `until`. In Init/Idle a sample has no other effect."""
    if until >= chip.sample_end:
        chip.period = chip.reg[T]
        period = CLOCKS_PER_COUNT * (chip.period + 1)
        chip.sample_end += ((until - chip.sample_end) // period + 1) * period


@hot
def skip_samples(chip, samples):
    """Skip a number of whole sample periods of the HCTL-1100, in which nothing but the time changes."""
    rest = samples * CLOCKS_PER_COUNT * (chip.period + 1)
    chip.clock += rest
    chip.sample_end += rest
    chip.computing_until += rest


@hot
def read_timer(chip):
    """Return the present count of the sample timer, which a read of R0F returns."""
    return 0 if chip.timer_stopped else (chip.sample_end - 1 - chip.clock) // CLOCKS_PER_COUNT


@hot
def apply_sync(chip):
    """Stop the timer at 0 while SYNC is asserted in Init/Idle; start it again when the pin or the mode ends."""
    hold = chip.mode == IDLE and chip.inputs & SYNC
    if hold and not chip.timer_stopped:
        chip.timer_stopped, chip.sample_end = 1, NEVER
    elif chip.timer_stopped and not hold:
        chip.timer_stopped = 0
        start_period(chip)
