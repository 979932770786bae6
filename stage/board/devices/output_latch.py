"""Output port: a latch of 8 bits that can be read back, for example for enable lines, brakes or lamps."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from stage.board.bus.host_record import OUT8
from stage.board.devices import output_latch_core
from stage.board.devices.device import CompiledDevice, DeviceDescriber


class OutputLatch(CompiledDevice):
    """8-bit output port that reads back its value; 0 at power-up.

    Args:
        changed: Function changed(before, after), called in the bus cycle that changes the outputs, with the stage at
            the time of the cycle. With it, each cycle of the port calls Python.
        name: Name in messages.
    """

    KIND = "latch"
    PORTS = 1
    CORE: ClassVar = output_latch_core

    def __init__(self, changed: Callable[[int, int], object] | None = None, name: str | None = None):
        super().__init__(name=name)
        self._changed = changed
        if changed is not None:
            self.access = 0

    @property
    def value(self) -> int:
        """Current outputs."""
        return int(self.registers["value"])

    def access_register(self, register: int, kind: int, value: int) -> int:
        """Write the outputs and call the user's function, or read the outputs back."""
        before = self.value
        if kind == OUT8 and value != before:
            self.registers["value"] = value
            if self._changed is not None:
                self._changed(before, value)
        return self.value

    def name_port(self, register: int) -> str:
        """Return the name of port `register`. A latch has one port, so `register` is 0."""
        return "outputs"

    def make_describer(self) -> DeviceDescriber:
        """Return a function that explains bus cycles of this latch."""
        return lambda n, value, writes, wide: f"outputs {'<-' if writes else '='} {value:08b}"
