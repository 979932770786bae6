"""An HCTL-1100 on the bench: bytes in, whole positions and samples out."""

from __future__ import annotations

from stage.chips import HCTL1100
from support.hctl1100_programs import FINAL, acceleration, begin, word

SAMPLE = 16 * 0x41  # clocks, after reset
LEAST = 0x0F  # counts of the timer after which commands may be written in any control mode


def bench(*writes, clock_hz=None):
    """A chip that was told these lists of writes."""
    chip = HCTL1100(clock_hz)
    write_all(chip, *writes)
    return chip


def write_all(chip, *writes):
    for some in writes:
        for address, value in some:
            chip.write(address, value)


def position(chip):
    """The actual position as a host reads it: low byte first, which latches."""
    low, middle, high = (chip.read(a) for a in (0x14, 0x13, 0x12))
    return signed(high << 16 | middle << 8 | low, 24)


def commanded(chip):
    return signed(chip.read(0x0C) << 16 | chip.read(0x0D) << 8 | chip.read(0x0E), 24)


def signed(value, bits):
    return value - (1 << bits) if value >> (bits - 1) & 1 else value


def to_sample(chip):
    """Advance to the next sample of a chip whose command position moves."""
    at = chip.command_position
    while chip.command_position == at:
        chip.advance(1)


def moving(v=1, a=0x100, t=0x40):
    """A chip in integral velocity whose command position moves by `v` a sample."""
    chip = bench([(0x0F, t)], acceleration(a), begin("integral"))
    chip.advance(SAMPLE + 16 * LEAST)
    chip.write(0x3C, v & 0xFF)
    return chip


def trapezoid(goal, a=64, top=8):
    """A chip that has just begun a move from 0 to `goal`."""
    return bench(word(FINAL, goal), acceleration(a), [(0x28, top)], begin("trapezoid"))
