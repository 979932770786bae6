"""Bus layout of the TMC5160: the two ports by which a host reaches its SPI."""

from __future__ import annotations

from pulsestage_trinamic.tmc5160 import TMC5160
from pulsestage_trinamic.tmc5160.maps import SPI_BYTE, SPI_CS
from stage.board.bus_layouts import BYTE, Layout

SPI = Layout(
    "tmc5160", "SPI: +0 chip select (0 begins a datagram, 1 ends it), +1 a byte out, then the byte that came in", TMC5160,
    ((BYTE, SPI_CS), (BYTE, SPI_BYTE)), 2, evidence="I",
)  # fmt: skip
