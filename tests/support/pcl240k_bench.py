"""A PCL-240K on the bench: bus and pins alone, and random legal speeds whose seed is printed.

PULSESTAGE_SEED repeats a run. The test ids do not tell the random values, so that all pytest-xdist workers collect alike.
"""

import numpy as np
import pytest

from stage.chips import PCL240K
from support.examples import SEED
from support.programs import load_registers

FOREVER = 1 << 42
RNG = np.random.default_rng(SEED)


def random_speed():
    lows, highs = (1, 401, 2, 2, 2), (400, 8192, 200, 200, 60)
    return tuple(int(RNG.integers(low, high)) for low, high in zip(lows, highs, strict=True))


SPEEDS = [(50, 800, 300, 300, 20), (25, 500, 1500, 700, 30), (100, 8191, 2, 2, 2), (1, 40, 16383, 9000, 1023)]
RANDOM = [random_speed() for _ in range(6)]
speeds = pytest.mark.parametrize(
    ("fl", "fh", "up", "down", "mult"),
    [*SPEEDS, *(pytest.param(*values, id=f"random{n}") for n, values in enumerate(RANDOM))],
)


def started(fl, fh, up, down, mult, r0=0xFFFFFF, r6=0, control=0x40, start=0x15, fh2=None):
    chip = PCL240K()
    load_registers(chip, R0=r0, R1=fl, R2=fh, R3=fh if fh2 is None else fh2, R4=up, R5=down, R6=r6, R7=mult)
    chip.write(0, control)
    chip.write(0, start)
    print(f"R1 {fl} R2 {fh} R4 {up} R5 {down} R7 {mult} R0 {r0} R6 {r6}, PULSESTAGE_SEED={SEED}")
    return chip


def commands(chip, *values):
    for value in values:
        chip.write(0, value)


def counter(chip):
    return chip.read(3) << 16 | chip.read(2) << 8 | chip.read(1)


def operating(chip):
    return bool(chip.read(0) & 0x40)


def clocks_while(chip, condition):
    """Advance to the first tick at which a condition no longer holds; found by doubling and bisection on snapshots.

    condition: a pin's name, or a function of the chip. It must not come back once it is gone.
    """
    holds = condition if callable(condition) else lambda chip: getattr(chip.pins, condition)
    start, state = chip.clock, chip.snapshot()

    def holds_after(clocks):
        chip.restore(state)
        chip.advance(clocks)
        return holds(chip)

    low, high = -1, 0
    while holds_after(high):
        assert high < FOREVER, "it never ends"
        low, high = high, max(2 * high, 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if holds_after(middle) else (low, middle)
    chip.restore(state)
    chip.advance(high)
    return chip.clock - start


def pins_clock_by_clock(chip, clocks, *names):
    """Rows of levels, one for each clock."""
    rows = []
    for _ in range(clocks):
        chip.advance(1)
        rows.append([bool(getattr(chip.pins, name)) for name in names])
    return np.array(rows)
