"""Loops over an HCTL-1100."""

from stage.chips.hctl1100 import core
from stage.native import array_of, exported, hot

A, B, K, T = 0xE5, 0x40, 0x40, 0x39
SAMPLE = 16 * (T + 1)  # clocks


@hot
def _clipped(value):
    return -128 if value < -128 else 127 if value > 127 else value


@exported("i8", core.STATE, array_of("i8"), array_of("i8"), array_of("i8"))
def play(c, moments, steps, noise):
    """Write a new command `moments[n]` clocks into each sample n, moved by steps[n]; the shaft follows the command
    of the sample before, off by noise[n]. Return how many samples had another motor command than that of the control law."""
    command = before = output = corrupted = 0
    begin = c.sample_end
    for n in range(len(moments)):
        shaft = command + noise[n]
        core.set_shaft(c, 0, float(shaft), 0.0)
        core.advance(c, begin)  # the sample of the command written before
        x = command - shaft
        output = _clipped((256 * K * x - A * K * before - 4 * B * output) >> 10)
        before = x
        wrong = c.motor_command != output
        command += steps[n]
        core.advance(c, begin + moments[n])
        for k in range(3):
            core.write(c, 0x0C + k, (command >> 8 * (2 - k)) & 0xFF)
        wrong = wrong or c.motor_command != output
        core.advance(c, begin + SAMPLE - 1)
        wrong = wrong or c.motor_command != output
        begin += SAMPLE
        corrupted += 1 if wrong else 0
    return corrupted
