"""`Port`: an axis of an MCX514 as its driver's author sees it. Nothing here but bus cycles and waiting."""

from __future__ import annotations

from stage.chips import MCX514
from stage.chips.nova.registers.mcx514 import MCX514_MAP as MAP
from stage.errors import ArgumentError
from stage.firmware.axis import Axis

POLL = 1e-3  # s between two looks
ERRORS = ("SLMT+", "SLMT-", "HLMT+", "HLMT-", "ALARM", "EMG", "HOME", "CERR")
"""Error bits of RR2."""


class Port:
    """The bus of one axis. Raises ArgumentError when the axis' chip is no MCX514."""

    def __init__(self, axis: Axis):
        if not isinstance(getattr(axis, "chip", None), MCX514):
            raise ArgumentError(f"{axis!r} has no MCX514: make the stage with chips=MCX514.")
        self.axis, self.chip = axis, axis.chip
        self.bit = 1 << axis.chip_axis

    def command(self, symbol: str) -> None:
        """A command to the axis, or to the chip where it carries no axis bits."""
        c = MAP.command(symbol)
        self.chip.write(0, (self.bit << 8 if c.axes else 0) | c.code)

    def load(self, **values: int) -> None:
        """Write parameters and modes by name: SV, DV, TP, H1M, IPM ... Raises ArgumentError, before the first bus cycle."""
        for name, value in [(n, MAP.checked(n, v)) for n, v in values.items()]:
            for cycle in self.chip.register_cycles(name, value, self.axis.chip_axis):
                self.chip.write(*cycle)

    def mode(self, **words: int) -> None:
        """Write WR1, WR2, WR3."""
        self.command("NOP")
        for name, value in words.items():
            self.chip.write(int(name[2]), value)

    def word(self, n: int) -> int:
        """RR1, RR2 or RR3 (page 0) of the axis."""
        self.command("RR3P0" if n == 3 else "NOP")
        return self.chip.read(n)

    def value(self, symbol: str) -> int:
        """What a data reading command says, of 32 bits with a sign: R-LP, CV ..."""
        self.command(symbol)
        word = self.chip.read(6) | self.chip.read(7) << 16
        return word - (word >> 31 << 32)

    def errors(self) -> tuple[str, ...]:
        """The error bits of RR2 that are set, by name."""
        word = self.word(2)
        return tuple(name for name in ERRORS if word & MAP.mask("RR2", name))


def mask(word: str, *names: str) -> int:
    """Bits of a word or mode register."""
    return sum(MAP.mask(word, name) for name in names)


def same_chip(axes: tuple[Axis, ...]) -> list[Port]:
    """Ports of axes in the order of the chip's. Raises ArgumentError where they are not axes of one MCX514."""
    ports = sorted((Port(axis) for axis in axes), key=lambda port: port.bit)
    if not ports or len({id(port.chip) for port in ports}) > 1 or len({port.bit for port in ports}) < len(ports):
        raise ArgumentError(f"axes {', '.join(a.name for a in axes) or 'none'}: give different axes of one MCX514.")
    return ports


def stop(ports: list[Port]) -> None:
    """Stop axes at once."""
    for port in ports:
        port.command("DRVFBRK")
