"""`HostDiagnostics`: diagnostics of a chip's bus writes, as far as an agent may know them.

`Chip.diagnostics` may follow from inputs that no register shows, as "start towards an asserted limit switch" where the status has
no bit for the switch. In host mode each write is judged once more on a copy of the chip whose hidden inputs are released.
"""

from __future__ import annotations

from collections import deque

from stage.chips.chip import Chip
from stage.chips.diagnostics import Diagnostic

MAX_DIAGNOSTICS = 200


class HostDiagnostics:
    """Diagnostics of one chip.

    Args:
        chip: The chip whose writes are judged.
        host: Leave out what follows from inputs that the host cannot read.

    Attributes:
        readable: Names of the pins that the host can read.
    """

    def __init__(self, chip: Chip, host: bool):
        self.chip, self._host = chip, host
        self._found = deque[Diagnostic](maxlen=MAX_DIAGNOSTICS)
        self.readable = find_readable_pins(type(chip))
        self._mask = sum(bit for name, bit in chip.INPUTS.items() if name in self.readable)
        if host:
            chip.glitches += (self._judge,)

    def all(self) -> list[Diagnostic]:
        """Return the last `MAX_DIAGNOSTICS` diagnostics, oldest first."""
        return list(self._found) if self._host else list(self.chip.diagnostics)[-MAX_DIAGNOSTICS:]

    def close(self) -> None:
        """Stop judging writes."""
        self.chip.glitches = tuple(g for g in self.chip.glitches if g != self._judge)

    def _judge(self, address: int, value: int) -> bool:
        """Judge a write before it reaches the chip; False: the write is not lost."""
        if any(self.chip.lint(address, value)):
            twin = self.chip.make_replica()
            for k in range(twin.AXES):
                twin.set_input_word(k, twin.input_word(k) & self._mask)
            for rule, message in twin.lint(address, value):
                if not rule.once or all(d.key != rule.key for d in self._found):
                    self._found.append(Diagnostic(self.chip.clock, address, value, message, rule.source, rule.key))
        return False


def find_readable_pins(kind: type[Chip]) -> frozenset[str]:
    """Find the pins that registers and words of the chip show, by its register map."""
    return frozenset(pin.removeprefix("/") for place in kind.MAP.places for f in place.fields for pin in f.pins)
