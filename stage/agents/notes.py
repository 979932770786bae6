"""`Notes`: the writes to a chip that a reader of the data sheet would call mistakes, as far as an agent may know them.

`Chip.diagnostics` may follow from inputs that no register shows: "start towards an asserted limit switch", where the status has no
bit for it. In host mode each write is read once more by a twin whose hidden inputs are released, and what remains is noted.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from stage.chips.chip import Chip, Diagnostic, Limit

MOST = 200


class Notes:
    """Of one chip. host: without what follows from hidden inputs."""

    def __init__(self, chip: Chip, host: bool):
        self.chip, self._host = chip, host
        self._own = deque[Diagnostic](maxlen=MOST)
        self.readable = readable_pins(type(chip))
        self._mask = sum(bit for name, bit in chip.INPUTS.items() if name in self.readable)
        if host:
            chip.glitches += (self._look,)

    def all(self) -> list[Diagnostic]:
        """Oldest first, the last MOST of them."""
        return list(self._own) if self._host else list(self.chip.diagnostics)[-MOST:]

    def close(self) -> None:
        """Look no more."""
        self.chip.glitches = tuple(g for g in self.chip.glitches if g != self._look)

    def _look(self, address: int, value: int) -> bool:
        """Before each write. It loses none."""
        if self.chip.mistake(address, value):
            twin = self.chip.twin()
            for k in range(twin.AXES):
                twin.set_input_word(k, twin.input_word(k) & self._mask)
            said = twin.mistake(address, value)
            if said and not (isinstance(said, Limit) and any(_same(d, said) for d in self._own)):
                self._own.append(Diagnostic(self.chip.clock, address, value, *said))
        return False


def readable_pins(kind: type[Chip]) -> frozenset[str]:
    """The pins that a host can read in the chip's registers and words, by the register map."""
    return frozenset(pin.removeprefix("/") for place in kind.MAP.places for f in place.fields for pin in f.pins)


def _same(noted: Diagnostic, said: Any) -> bool:
    return noted.source == said.source and noted.message.split(":")[0] == said.message.split(":")[0]
