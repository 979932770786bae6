"""Bus cycles of the ACME1000 in words, for traces and recordings; and what a reader of the data sheet would call mistakes."""

from acme_chips.maps import CONTROL, MAP, STATUS
from stage.chips import describe
from stage.chips.describe import Fields, Said

NAMES = {r.number: r.name for r in MAP.registers}
FIELDS = Fields(STATUS)


def wrote(address, value):
    """What a write cycle says."""
    if address == 0:
        return MAP.by_code[value].title if value in MAP.by_code else Fields(CONTROL).tell("control", value)
    return f"{NAMES[address]} <- {value}" if address in NAMES else "nothing is there"


class Listener:
    """Tells each bus cycle."""

    def write(self, address, value):
        return wrote(address, value)

    def read(self, address, value):
        return FIELDS.tell("status", value) if address == 0 else f"{NAMES.get(address, 'nothing')} = {value}"


class Decoder(describe.Decoder):
    """Tells the writes of a journal."""

    def wrote(self, clock, address, value):
        kind, name = ("register", NAMES.get(address, "")) if address else ("command", "")
        return [Said(clock, kind, f"{address} {value:04X}", wrote(address, value), name, value)]

    def lost(self, address, value):
        return f"{address} {value:04X}", wrote(address, value)


def mistake(c, address, value):
    """(what, where it is written) of a write that is a mistake; None if it is none. c: the state before."""
    if address in NAMES:
        r = MAP.register(NAMES[address])
        return None if r.allows(value) else (f"{r.name} takes {r.range[0]} to {r.range[1]}", "table 1")
    if address:
        return f"nothing is at address {address}", "table 1"
    if not value & 1:
        return None
    start, drive, slope, count = (int(c["reg"][k]) for k in (1, 2, 3, 4))
    if c["way"]:
        return "a start while it drives is ignored", "section 3"
    if not start or (value & 4 and not count):
        return f"no pulse will come: {'START' if not start else 'COUNT'} is 0", "section 3"
    if value & 16 and (drive < start or not slope):
        return "no ramp: " + ("DRIVE is below START" if drive < start else "SLOPE is 0"), "section 3"
    return None
