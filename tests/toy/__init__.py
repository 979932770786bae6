"""An exercise: a family of chips that PulseStage does not know. Two registers, three commands, one axis.

map, core, words and driver are all in this folder; `Stage(chips=TOY)` and the rest take the class as it is.
"""

from __future__ import annotations

from typing import Any, ClassVar

from stage.chips.chip import Chip
from toy import core
from toy.maps import MAP
from toy.words import Decoder, Listener


class TOY(Chip):
    """RATE pulses a second, COUNT of them, plus or minus."""

    MAP: ClassVar = MAP
    CORE: ClassVar = core
    INPUTS: ClassVar = core.INPUTS
    OUTPUTS: ClassVar = core.OUTPUTS
    DRIVER: ClassVar = "toy.driver:ToyDriver"
    DEFAULT_CLOCK_HZ: ClassVar = 1_000_000
    DATA_MASK: ClassVar = 0xFFFF
    BUSY: ClassVar = (0, 1)
    COUNTER: ClassVar = ("COUNT", 16)

    def _configure(self, record: Any) -> None:
        record["hz"] = self.clock_hz

    @classmethod
    def register_cycles(cls, name: str, value: int, axis: int = 0) -> list[tuple[int, int]]:
        return [(cls.MAP.register(name).number, value)]

    def decoder(self, axis: int = 0) -> Decoder:
        return Decoder()

    def listener(self) -> Listener:
        return Listener()

    def values(self) -> dict[str, int]:
        return {r.name: core.peek.held(self.pointer, r.number) for r in MAP.registers}
