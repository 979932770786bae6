"""A family of chips outside the product: two registers and three commands per axis, with one axis or eight.

The register map, core, words and driver are all in this folder; `Stage(chips=TOY)` takes the class as it is.
"""

from __future__ import annotations

from typing import Any, ClassVar

from stage.chips.chip import Chip
from toy import core, eight
from toy.maps import AXES, MAP, MAP8
from toy.words import CycleDescriber, Decoder


class TOY(Chip):
    """A chip that emits COUNT pulses at RATE pps in the plus or minus direction."""

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
        register_name = name if cls.AXES == 1 or name[-1].isdigit() else f"{name}{axis}"
        return [(cls.MAP.register(register_name).number, value)]

    def decoder(self, axis: int = 0) -> Decoder:
        return Decoder(self.MAP)

    def make_describer(self) -> CycleDescriber:
        return CycleDescriber(self.MAP)

    def values(self) -> dict[str, int]:
        return {r.name: self.CORE.peek.with_gil(self.pointer, r.number) for r in self.MAP.registers}


class TOY8(TOY):
    """A chip with eight axes like that of the TOY."""

    MAP: ClassVar = MAP8
    CORE: ClassVar = eight
    AXES: ClassVar = AXES
    ADDRESSES: ClassVar = 32
    ADDRESS_MASK: ClassVar = 31
