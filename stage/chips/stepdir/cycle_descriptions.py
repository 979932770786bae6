"""Bus cycles of the step timer in words, for traces and recordings. The lines themselves are pins, not bus cycles."""

from __future__ import annotations

from stage.chips import cycle_descriptions
from stage.chips.cycle_descriptions import FieldDescriber, Statement
from stage.chips.stepdir.maps import ADDRESS_MASK, CONTROL, CONTROL_ADDRESS, DATA_MASK, MAP, STATUS

NAMES = {r.number: r.name for r in MAP.registers}
CONTROL_FIELDS, STATUS_FIELDS = FieldDescriber(CONTROL), FieldDescriber(STATUS)


def describe_write(address: int, value: int) -> str:
    """Describe a write cycle."""
    address, value = address & ADDRESS_MASK, value & DATA_MASK
    if address == CONTROL_ADDRESS:
        return MAP.by_code[value].title if value in MAP.by_code else CONTROL_FIELDS.describe("control", value)
    return f"{NAMES[address]} <- {value}" if address in NAMES else "nothing is at this address"


class CycleDescriber:
    """Describer of the bus cycles of the step timer."""

    def write(self, address: int, value: int) -> str:
        return describe_write(address, value)

    def read(self, address: int, value: int) -> str:
        address, value = address & ADDRESS_MASK, value & DATA_MASK
        if address == CONTROL_ADDRESS:
            return STATUS_FIELDS.describe("status", value)
        return f"{NAMES[address]} = {MAP.register(NAMES[address]).value(value)}" if address in NAMES else "no register"


class Decoder(cycle_descriptions.Decoder):
    """Decoder of the writes to the step timer in a journal."""

    def decode_write(self, clock: int, address: int, value: int) -> list[Statement]:
        kind, name = ("command", "") if address == CONTROL_ADDRESS else ("register", NAMES.get(address, ""))
        return [Statement(clock, kind, f"{address:X} {value:X}", describe_write(address, value), name, value)]

    def describe_lost_write(self, address: int, value: int) -> tuple[str, str]:
        return f"{address:X} {value:X}", describe_write(address, value)
