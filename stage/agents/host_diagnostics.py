"""`HostDiagnostics`: diagnostics of a chip's bus writes that reveal nothing a host could not know.

`Chip.diagnostics` may depend on inputs that no register shows, for example "start towards an asserted limit switch" on a chip
whose status has no bit for that switch. In host mode, each write is checked again on a copy of the chip without its hidden inputs.
"""

from __future__ import annotations

from collections import deque

from stage.chips.chip import Chip
from stage.chips.write_diagnostics import Diagnostic

MAX_DIAGNOSTICS = 200


class HostDiagnostics:
    """Diagnostics of one chip, for tools of an agent.

    Args:
        chip: The chip whose writes are checked.
        host: Whether to omit diagnostics that depend on inputs which the host cannot read.

    Attributes:
        readable: Names of the pins that the host can read.
    """

    def __init__(self, chip: Chip, host: bool):
        self.chip, self._host = chip, host
        self._found = deque[Diagnostic](maxlen=MAX_DIAGNOSTICS)
        self.readable = find_readable_pins(type(chip))
        self._mask = sum(bit for name, bit in chip.INPUTS.items() if name in self.readable)
        if host:
            chip.glitches += (self._diagnose_write,)

    def list_all(self) -> list[Diagnostic]:
        """Return the last `MAX_DIAGNOSTICS` diagnostics, oldest first."""
        return list(self._found) if self._host else list(self.chip.diagnostics)[-MAX_DIAGNOSTICS:]

    def close(self) -> None:
        """Stop checking writes."""
        self.chip.glitches = tuple(g for g in self.chip.glitches if g != self._diagnose_write)

    def _diagnose_write(self, address: int, value: int) -> bool:
        """Check a write before it reaches the chip, and store its diagnostics.

        Returns:
            False, which tells the chip that the write is not lost on the bus.
        """
        if any(self.chip.lint(address, value)):
            twin = self.chip.make_replica()
            for k in range(twin.AXES):
                twin.set_input_word(k, twin.input_word(k) & self._mask)
            for rule, message in twin.lint(address, value):
                if not rule.once or all(d.key != rule.key for d in self._found):
                    self._found.append(Diagnostic(self.chip.clock, address, value, message, rule.source, rule.key))
        return False


def find_readable_pins(kind: type[Chip]) -> frozenset[str]:
    """Return the names of the pins that registers and words of the chip show, according to its register map."""
    return frozenset(pin.removeprefix("/") for place in kind.MAP.places for f in place.fields for pin in f.pins)
