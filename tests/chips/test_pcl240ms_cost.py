"""An S-curve costs little more than a linear ramp where it counts, in the engine."""

import time

from support.programs import load_registers

from stage import Stage
from stage.chips import PCL240MS

LINEAR = 0x1000  # R14
STEPS, RATE = 4000, 300


def seconds(stage, r14):
    """Return the CPU time of half a second in which three axes ramp up and down."""
    stage.reset()
    for axis in stage.axes.values():
        chip = axis.chip
        load_registers(chip, R0=0xFFFFFF, R1=50, R2=50 + STEPS, R3=50, R4=RATE, R5=RATE, R6=0, R7=200)
        chip.write(0, 0x94)
        for address in (3, 2, 1):
            chip.write(address, r14 >> 8 * (address - 1) & 0xFF)
        chip.write(0, 0x40)
        chip.write(0, 0x15)
    begin = time.process_time()
    for command in (0x14, 0x15):
        stage.run(0.25)
        for axis in stage.axes.values():
            assert axis.chip.pins.fkeep
            axis.chip.write(0, command)
    return time.process_time() - begin


def test_an_s_curve_takes_at_most_half_as_much_time_again_as_a_linear_ramp():
    stage = Stage("xyz", chips=PCL240MS, visuals=False)
    pairs = [(seconds(stage, 0), seconds(stage, LINEAR)) for _ in range(9)]
    curved, linear = (min(side) for side in zip(*pairs, strict=True))
    print(f"S-curve {curved / linear:.2f} times a linear ramp")
    assert curved < 1.5 * linear
