"""Hands on a TMC5160 reference: registers by name, waits in clocks."""

from tmc5160_reference.chip import Reference
from tmc5160_reference.registers import ADDRESS

PLUS, MINUS, HOLD = 1, 2, 3  # RAMPMODE


def ready(**registers):
    chip = Reference(12_000_000)
    put(chip, CHOPCONF=0x10000003, **registers)
    return chip


def put(chip, **registers):
    for name, value in registers.items():
        chip.write(ADDRESS[name], value)


def get(chip, name):
    return chip.read(ADDRESS[name])


def bit(chip, number, name="RAMP_STAT"):
    return get(chip, name) >> number & 1


def speed(chip):
    return chip.q >> 17


def until(chip, met, limit=150_000):
    """The clock after which it is met."""
    for _ in range(limit):
        chip.tick()
        if met():
            return chip.clock
    raise AssertionError(f"not met in {limit} clocks: q {chip.q}, dir {chip.dir}, {chip.steps[-3:]}")


def glide(chip, v, direction=1):
    """At this speed in hold mode, with all that follows from it."""
    chip.q, chip.dir = v << 17, direction if v else 0
    put(chip, RAMPMODE=HOLD)
