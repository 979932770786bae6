"""The ACME1000 for PulseStage: `Stage("xyz", chips="acme1000")`."""

from typing import ClassVar

from acme_chips import core, words
from acme_chips.maps import MAP
from stage.chips import Chip


class ACME1000(Chip):
    """One axis, 16-bit bus; addresses: 0 control (write) and status (read), 1 to 4 START, DRIVE, SLOPE and COUNT."""

    MAP: ClassVar = MAP
    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    PHASES: ClassVar = {"up": "up", "down": "down", "run": "keep"}
    DRIVER: ClassVar = "acme_chips.driver:AcmeDriver"
    DEFAULT_CLOCK_HZ: ClassVar = 8_000_000
    ADDRESSES: ClassVar = 8
    ADDRESS_MASK: ClassVar = 7
    DATA_MASK: ClassVar = 0xFFFF
    BUSY: ClassVar = (0, 1)
    COUNTER: ClassVar = ("COUNT", 16)

    def _configure(self, record):
        record["hz"] = self.clock_hz

    @classmethod
    def register_cycles(cls, name, value, axis=0):
        return [(cls.MAP.register(name).number, value)]

    @classmethod
    def find_selected_direction(cls, address, value):
        return bool(value & core.MINUS) if address == 0 and value & core.GO else None

    def decoder(self, axis=0):
        return words.Decoder()

    def make_describer(self):
        return words.CycleDescriber()

    def values(self):
        return {r.name: core.peek.with_gil(self.pointer, r.number) for r in self.MAP.registers}

    def lint(self, address, value):
        return words.lint(self._record, address, value)
