"""LS7166 (LSI Computer Systems): a quadrature counter of 24 bits.

Facts of the data sheet: data at C/D low, a byte at a time from a pointer that a command resets: writes go to the preset register
PR, reads come from the output latch OL. Control words at C/D high name their register by bits 7 and 6:

    0  MCR    01h pointer = 0   02h latch the counter   04h counter = 0   08h counter = PR   10h COMPT = 0   20h master reset
    1  ICR    08h the inputs A and B count   02h, 04h one up, one down
    2  OCCR   04h divide by N: reloaded from PR at carry and borrow
    3  QR     0 no quadrature, 1 x1, 2 x2, 3 x4

A read at C/D high is the status: bit 0 BWT, 1 CYT, 2 COMPT (toggles at borrow, carry, equality with PR), 3 SIGN (1 after a borrow,
0 after a carry), 4 counting up. Inferred: the meaning of SIGN, bits 5 to 7 read as 0, and the toggles see the net count between two
cycles. Not modeled: counting without quadrature, BCD, the 24-hour clock, single cycles, the pins LCTR, RCTR, CY and BW.

A card's choice: C/D is address line 0, data at +0, control at +1. The chip does not pull the interrupt line.
"""

from __future__ import annotations

from typing import ClassVar

from stage.board.devices import ls7166_core
from stage.board.devices.device import CompiledDevice, DeviceDescriber, Encoder

_REGISTERS = ("MCR", "ICR", "OCCR", "QR")
_MASTER = ("pointer = 0", "latch the counter", "counter = 0", "counter = PR", "COMPT = 0", "master reset")
_STATUS = ("BWT", "CYT", "COMPT", "SIGN", "up")


class LS7166(CompiledDevice):
    """Quadrature counter of 24 bits: LS7166(Encoder("x", per_turn=2000))."""

    KIND = "ls7166"
    PORTS = 2
    CORE: ClassVar = ls7166_core

    def __init__(self, encoder: Encoder, name: str | None = None):
        super().__init__(name=name, encoders=(encoder,))
        self.registers["pr"] = ls7166_core.COUNT_MODULUS - 1

    def name_port(self, register: int) -> str:
        """Return the name of a port in traces."""
        return ("data", "control")[register]

    def make_describer(self) -> DeviceDescriber:
        """Return a function that explains bus cycles of this counter, with the command of each control byte."""

        def describe(n: int, value: int, writes: bool, wide: bool) -> str:
            """Explain one bus cycle."""
            if n == 0:
                return f"PR byte <- {value:02X}h" if writes else f"OL byte = {value:02X}h"
            bits = value & 0x3F if writes else value
            if not writes:
                return "status: " + (", ".join(t for k, t in enumerate(_STATUS) if bits >> k & 1) or "none")
            register = _REGISTERS[value >> 6]
            if register == "MCR":
                return "MCR: " + (", ".join(t for k, t in enumerate(_MASTER) if bits >> k & 1) or "nothing")
            if register == "QR":
                return "QR: " + ("no quadrature", "x1", "x2", "x4")[bits & 3]
            return f"{register} <- {bits:02X}h"

        return describe
