"""An output port: a latch of 8 bits that reads back, as for enable lines, brakes, lamps."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from stage.board.bus.host_record import OUT8
from stage.board.devices import latch_core
from stage.board.devices.device import Compiled, Listener


class Latch(Compiled):
    """An 8-bit output port with read back, 0 at power-up.

    Args:
        changed: Function that is called as changed(before, after) in the cycle that changes the outputs, with the stage at its
            time;
            every cycle of the port is then a call of Python.
        name: What messages call it.
    """

    KIND = "latch"
    PORTS = 1
    CORE: ClassVar = latch_core

    def __init__(self, changed: Callable[[int, int], object] | None = None, name: str | None = None):
        super().__init__(name=name)
        self._changed = changed
        if changed is not None:
            self.access = 0

    @property
    def value(self) -> int:
        """The outputs."""
        return int(self.registers["value"])

    def access_register(self, n: int, kind: int, value: int) -> int:
        """Write the outputs and call the function that observes them, or read them back."""
        before = self.value
        if kind == OUT8 and value != before:
            self.registers["value"] = value
            if self._changed is not None:
                self._changed(before, value)
        return self.value

    def name_port(self, n: int) -> str:
        """All eight outputs are one port."""
        return "outputs"

    def make_describer(self) -> Listener:
        """Describe an access in the trace."""
        return lambda n, value, writes, wide: f"outputs {'<-' if writes else '='} {value:08b}"
