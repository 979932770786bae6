"""An S-curve costs little more than a linear ramp: a square root a step."""

import time

from programs import load_registers

from stage.chips import PCL240MS

STEPS, RATE = 7950, 3


def seconds(r14):
    """Time of twenty ramps up and down, of 7950 steps each."""
    chip = PCL240MS()
    load_registers(chip, R0=0xFFFFFF, R1=50, R2=50 + STEPS, R3=50, R4=RATE, R5=RATE, R6=0, R7=2)
    chip.write(0, 0x94)
    for address in (3, 2, 1):
        chip.write(address, r14 >> 8 * (address - 1) & 0xFF)
    chip.write(0, 0x40)
    chip.write(0, 0x15)
    begin = time.perf_counter()
    for _ in range(20):
        for command in (0x14, 0x15):
            chip.advance(2 * STEPS * RATE)
            assert chip.pins.fkeep
            chip.write(0, command)
    return time.perf_counter() - begin


def test_an_s_curve_costs_at_most_half_as_much_again_as_a_linear_ramp():
    pairs = [(seconds(0), seconds(0x1000)) for _ in range(9)]
    curved, linear = (min(side) for side in zip(*pairs, strict=True))
    print(f"S-curve {curved / linear:.2f} times a linear ramp")
    assert curved < 1.5 * linear
