"""A PCL-240MK or MS in the hand: set up, started, read back, waited for; and what the registers are."""

import numpy as np
import pytest

from stage.chips import PCL240K, PCL240MK, PCL240MS
from support.pcl240k_bench import FOREVER, commands, counter, operating
from support.pcl240ms_bench import load

BOTH = pytest.mark.parametrize("make", [PCL240MK, PCL240MS])
ALL = pytest.mark.parametrize("make", [PCL240K, PCL240MK, PCL240MS])
PLAIN = 0x44  # control mode: preset, without the automatic ramp-down point

K_BITS = {"R0": 24, "R1": 13, "R2": 13, "R3": 13, "R4": 14, "R5": 14, "R6": 20, "R7": 10}
EXTENSION_BITS = {"R10": 24, "R11": 24, "R12": 24, "R13": 24, "R14": 16, "R15": 12, "R16": 24, "R17": 24}
BITS = {
    PCL240K: K_BITS,
    PCL240MK: K_BITS | EXTENSION_BITS | {"R13": 23},  # its bit 23 "is fixed as 0"
    PCL240MS: K_BITS | EXTENSION_BITS | {"R4": 16, "R5": 16, "R6": 24},
}
READ_ONLY = {"R17": 0x1F0000}  # the EZ monitor of the MS; always 0 on the MK
NAMES = tuple(BITS[PCL240MS])
SWITCH_OFF = ("R1", "R4", "R5", "R14", "R15")  # writing one in motion disables the automatic point


def select(name):
    """R0 is 80h, R7 87h, R10 90h, R17 97h."""
    return (0x90 if len(name) == 3 else 0x80) | int(name[-1])


def begun(make, control=0x40, start=0x15, **registers):
    """Start a chip. Unless `registers` says otherwise, FL 50, FH 800: 20.48 clocks a pulse, 327.68 at FL. None: not written."""
    chip = make()
    values = {"R0": 0xFFFFFF, "R1": 50, "R2": 800, "R3": 800, "R4": 30, "R5": 30, "R7": 2, **registers}
    load(chip, **{name: value for name, value in values.items() if value is not None})
    commands(chip, control, start)
    return chip


def read_back(chip, name):
    """A register's value over the bus, in extension mode."""
    commands(chip, 0xC8, select(name))
    return counter(chip)


def kept(make, name):
    """Return the mask of the bits of a register that a write can set."""
    return (1 << BITS[make][name]) - 1 & ~READ_ONLY.get(name, 0)


def wait_for(chip, pin):
    """Advance to the first clock with the pin asserted, however short it is."""
    state = chip.snapshot()
    while not getattr(chip.pins, pin):
        assert operating(chip), f"{pin} never came"
        state = chip.snapshot()
        chip.advance(300)
    chip.restore(state)
    while not getattr(chip.pins, pin):
        chip.advance(1)


def last_gaps(chip):
    """Run to the end; clocks between the last five pulses."""
    clocks = chip.trace(FOREVER)["clock"]
    assert not operating(chip)
    return np.diff(clocks[-5:])


AT_FH, AT_FL = (20, 21), (327, 328)
