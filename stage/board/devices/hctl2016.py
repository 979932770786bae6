"""HCTL-2000, HCTL-2016 and HCTL-2020: quadrature decoders with a counter of 12 or 16 bits (HP, Agilent, Avago).

Facts of the data sheet: all four edges of a line count. A read with SEL low gives the high byte and inhibits the latch, so the low
byte, which a read with SEL high gives next, is of the same moment; that read ends the inhibition. Bits 4 to 7 of the high byte of
the HCTL-2000 are 0. /RST clears counter and latch. The chip has no interrupt.

A card's choice: SEL is address line 0, the high byte at +0, the low byte at +1, and a write to either of them is /RST.
"""

from __future__ import annotations

from typing import ClassVar

from stage.board.devices import hctl2016_core
from stage.board.devices.device import CompiledDevice, DeviceDescriber, Encoder


class HCTL2016(CompiledDevice):
    """Quadrature counter of 16 bits: HCTL2016(Encoder("x", per_metre=200_000))."""

    KIND = "hctl2016"
    BITS: ClassVar = 16
    PORTS = 2
    CORE: ClassVar = hctl2016_core

    def __init__(self, encoder: Encoder, name: str | None = None):
        super().__init__(name=name, encoders=(encoder,))
        self.registers["bits"] = self.BITS

    @property
    def count(self) -> int:
        """Current value of the counter."""
        return (self.counts[0] - int(self.registers["zero"])) & (1 << self.BITS) - 1

    def name_port(self, register: int) -> str:
        """Return the name of the counter's byte that a port reaches."""
        return ("high byte", "low byte")[register]

    def make_describer(self) -> DeviceDescriber:
        """Return a function that explains bus cycles of this counter."""
        return lambda n, value, writes, wide: "reset" if writes else f"{self.name_port(n)} = {value:02X}h"


class HCTL2000(HCTL2016):
    """Quadrature counter of 12 bits."""

    KIND = "hctl2000"
    BITS = 12


class HCTL2020(HCTL2016):
    """Quadrature counter of 16 bits. Its outputs for cascading are not connected."""

    KIND = "hctl2020"
