"""Bus writes of the NOVA chips in words, from the register map: `X Y DV <- 8000`, `X relative position drive`."""

from __future__ import annotations

from collections.abc import Iterable

from stage.chips.decode import Said
from stage.chips.entries import LOST, RESET, WRITE, Entry
from stage.chips.nova.registers.common import AXES
from stage.chips.nova.registers.mcx300 import RESET as RESET_WORD
from stage.chips.register_map import Command, RegisterMap

BYTES = 16  # byte addresses of the 8-bit bus begin here


def axis_names(axes: int) -> str:
    """Axes of a chip, bit 0 for X, by name."""
    return " ".join(AXES[k] for k in range(4) if axes >> k & 1)


def resets(map_: RegisterMap, value: int) -> bool:
    """Whether a word to WR0 is the reset of a chip that has no command for it."""
    return value == RESET_WORD and not map_.by_code.get(0xFF)


class Decoder:
    """What reaches one axis of a chip: its commands, with the data that they take, and its words WR1 to WR5."""

    def __init__(self, map_: RegisterMap, axis: int = 0):
        self._map, self._bit = map_, 1 << axis
        self._selected = 1
        self._words = [0] * 8

    def take(self, entries: Iterable[Entry]) -> list[Said]:
        """See `stage.chips.decode.Decoder`."""
        said: list[Said] = []
        for e in entries:
            if e.kind == WRITE:
                said += self._write(e.clock, e.a, e.b)
            elif e.kind == RESET:
                said.append(Said(e.clock, "reset", "/RESET", "reset pin"))
                self._selected, self._words = 1, [0] * 8
            elif e.kind == LOST:
                said.append(Said(e.clock, "lost", f"{e.b:04X}", f"LOST: data to WR{e.a & 7}"))
        return said

    def rest(self) -> list[Said]:
        """Nothing waits here."""
        return []

    def _write(self, clock: int, address: int, value: int) -> list[Said]:
        n = address
        if address >= BYTES:
            n, high = (address - BYTES) >> 1, address & 1
            old = self._words[n]
            value = old & 0xFF | value << 8 if high else old & 0xFF00 | value
            if n == 0 and high:
                self._words[0] = value
                return []
        self._words[n] = value
        if n == 0:
            return self._command(clock, value)
        if n >= 6 or (n <= 3 and not self._selected & self._bit):
            return []
        return [Said(clock, "register", f"{value:04X}", f"WR{n} <- {value:04X}h")]

    def _command(self, clock: int, value: int) -> list[Said]:
        axes, command = value >> 8 & 15, self._map.by_code.get(value & 0xFF)
        self._selected = axes or self._selected
        if axes and not axes & self._bit:
            return []
        kind = "command" if command is None or command.kind not in ("data write", "mode write") else "register"
        return [Said(clock, kind, f"{value:04X}", f"{axis_names(axes)} {self._meaning(command, value)}".strip())]

    def _meaning(self, command: Command | None, value: int) -> str:
        if resets(self._map, value):
            return "reset"
        if command is None:
            return "no command"
        if command.kind not in ("data write", "mode write"):
            return command.title
        r = self._map.register(command.symbol)
        return f"{r.name} <- {r.value(self._words[7] << 16 | self._words[6])} ({r.title})"
