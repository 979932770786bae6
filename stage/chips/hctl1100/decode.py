"""Bus writes of the HCTL-1100 in words, from the register map: `set F0`, `control`, `R22 <- 64 (filter: gain K)`."""

from __future__ import annotations

from collections.abc import Iterable

from stage.chips.decode import Said
from stage.chips.entries import LOST, RESET, WRITE, Entry
from stage.chips.hctl1100.maps import FLAG_WRITE
from stage.chips.register_map import RegisterMap

MODES = ("reset", "Init/Idle", "Align", "control")
_SET, _NUMBER = FLAG_WRITE.fields


class Decoder:
    """Every write is one register's: nothing waits for what comes next."""

    def __init__(self, map_: RegisterMap):
        self._registers = {r.number: r for r in map_.registers}

    def take(self, entries: Iterable[Entry]) -> list[Said]:
        """See `stage.chips.decode.Decoder`."""
        said: list[Said] = []
        for e in entries:
            if e.kind == WRITE:
                kind = "command" if e.a in (0x00, 0x05) else "register"
                said.append(Said(e.clock, kind, f"{e.a:02X} {e.b:02X}", self._meaning(e.a, e.b)))
            elif e.kind == RESET:
                said.append(Said(e.clock, "reset", "/RESET", "reset pin"))
            elif e.kind == LOST:
                said.append(Said(e.clock, "lost", f"{e.a:02X} {e.b:02X}", f"LOST: {self._meaning(e.a, e.b)}"))
        return said

    def rest(self) -> list[Said]:
        """Nothing waits here."""
        return []

    def _meaning(self, address: int, value: int) -> str:
        if address == 0x00:
            return f"{'set' if _SET.of(value) else 'clear'} F{_NUMBER.of(value)}"
        if address == 0x05:
            return MODES[value] if value < len(MODES) else "no mode"
        r = self._registers.get(address)
        return f"{r.name} <- {r.value(value)} ({r.title})" if r else f"no register at {address:02X}h"
