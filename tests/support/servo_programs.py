"""Bus programs for HCTL-1100 whose loop a stage closes, as drivers write them. `chip` is anything with `write`."""

SAMPLE = 0x0F  # T: 256 clocks, 128 us
FILTER = {0x20: 0xE5, 0x21: 0x40, 0x22: 0x20}  # zero, pole, gain: the shipped stages stand firm with it
F0, F3, F5 = 0x00, 0x03, 0x05


def write_bytes(chip, writes):
    for address, value in dict(writes).items():
        chip.write(address, value & 0xFF)


def control(chip, sample=SAMPLE, filter=FILTER):
    """Set the filter up and hold the position 0, from Init/Idle on."""
    write_bytes(chip, {0x0F: sample, **filter})
    write_bytes(chip, {0x0E: 0, 0x05: 0x03})


def trapezoid(chip, counts, velocity=4, acceleration=4):
    """Write a profile to this count, from position control. velocity: counts a sample; acceleration: 256ths of that a sample."""
    write_bytes(chip, {0x26: acceleration, 0x27: 0, 0x28: velocity})
    write_bytes(chip, {0x29: counts, 0x2A: counts >> 8, 0x2B: counts >> 16})
    chip.write(0x00, 0x08 | F0)


def run_on(chip, velocity, acceleration=8):
    """Write a run in integral velocity mode, from position control, counts a sample."""
    write_bytes(chip, {0x26: acceleration, 0x27: 0})
    chip.write(0x00, 0x08 | F5)
    chip.write(0x3C, velocity & 0xFF)


def move(chip, counts):
    """Write a program from power-up to the start of a trapezoid."""
    control(chip)
    trapezoid(chip, counts)
