"""Bus cycles of the ACME1000 in words, for traces and recordings; and the lint, which yields diagnostics."""

from acme_chips.maps import CONTROL, MAP, STATUS
from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import FieldDescriber, Statement
from stage.chips.write_diagnostics import Rule

NAMES = {r.number: r.name for r in MAP.registers}
FIELDS = FieldDescriber(STATUS)

VALUE_RANGE = Rule("value-range", "table 1")
NO_REGISTER = Rule("no-register", "table 1")
ALREADY_DRIVING = Rule("already-driving", "section 3")
NO_PULSES = Rule("no-pulses", "section 3")
NO_RAMP = Rule("no-ramp", "section 3")


def describe_write(address, value):
    """Describe a write cycle."""
    if address == 0:
        return MAP.by_code[value].title if value in MAP.by_code else FieldDescriber(CONTROL).describe("control", value)
    return f"{NAMES[address]} <- {value}" if address in NAMES else "nothing is there"


class CycleDescriber:
    """Descriptions of bus cycles."""

    def write(self, address, value):
        return describe_write(address, value)

    def read(self, address, value):
        return FIELDS.describe("status", value) if address == 0 else f"{NAMES.get(address, 'nothing')} = {value}"


class Decoder(cycle_descriptions.Decoder):
    """Decoder of journals."""

    def decode_write(self, clock, address, value):
        kind, name = ("register", NAMES.get(address, "")) if address else ("command", "")
        return [Statement(clock, kind, f"{address} {value:04X}", describe_write(address, value), name, value)]

    def describe_lost_write(self, address, value):
        return f"{address} {value:04X}", describe_write(address, value)


def lint(c, address, value):
    """Yield every rule of the data sheet that a write breaks, with a message. c: the state before it."""
    if address in NAMES:
        r = MAP.register(NAMES[address])
        if not r.allows(value):
            yield VALUE_RANGE, f"{r.name} takes {r.range[0]} to {r.range[1]}"
    elif address:
        yield NO_REGISTER, f"nothing is at address {address}"
    elif value & 1:
        start, drive, slope, count = (int(c["reg"][k]) for k in (1, 2, 3, 4))
        if c["way"]:
            yield ALREADY_DRIVING, "a start while it drives is ignored"
        if not start or (value & 4 and not count):
            yield NO_PULSES, f"no pulse will come: {'START' if not start else 'COUNT'} is 0"
        elif value & 16 and (drive < start or not slope):
            yield NO_RAMP, "no ramp: " + ("DRIVE is below START" if drive < start else "SLOPE is 0")
