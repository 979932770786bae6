"""Helpers that operate a TMC5160 reference: registers by name, waits in clocks."""

from tmc5160_reference.chip import Reference
from tmc5160_reference.registers import ADDRESS

PLUS, MINUS, HOLD = 1, 2, 3  # RAMPMODE


def create_reference(**registers):
    chip = Reference(12_000_000)
    write_registers(chip, CHOPCONF=0x10000003, **registers)
    return chip


def write_registers(chip, **registers):
    for name, value in registers.items():
        chip.write(ADDRESS[name], value)


def read_register(chip, name):
    return chip.read(ADDRESS[name])


def read_bit(chip, number, name="RAMP_STAT"):
    return read_register(chip, name) >> number & 1


def read_speed(chip):
    return chip.q >> 17


def tick_until(chip, condition, limit=150_000):
    """Tick until condition() holds and return the clock; fail after `limit` clocks."""
    for _ in range(limit):
        chip.tick()
        if condition():
            return chip.clock
    raise AssertionError(f"not met in {limit} clocks: q {chip.q}, dir {chip.dir}, {chip.steps[-3:]}")


def set_steady_speed(chip, v, direction=1):
    """Set the internal speed v in hold mode, and let the thresholds follow."""
    chip.q, chip.dir = v << 17, direction if v else 0
    write_registers(chip, RAMPMODE=HOLD)
