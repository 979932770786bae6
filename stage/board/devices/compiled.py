"""Base of the shipped devices: a record of state and two compiled functions over it."""

from __future__ import annotations

from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from stage.board.devices.device import Device
from stage.native import plain


class Compiled(Device):
    """A device whose module exports STATE, `access` and `pulls`, see stage.board.reaching.

    Attributes: options: its arguments; registers: its state by name.
    """

    CORE: ClassVar[Any]
    OPTIONS: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **base: Any):
        super().__init__(**base)
        core: ModuleType = self.CORE
        self.state = [np.zeros(1, core.STATE)]
        self.registers = self.state[0].view(plain(core.STATE))[0]
        self.access, self.pulls = core.access.address, core.pulls.address if hasattr(core, "pulls") else 0

    def twin(self) -> tuple[Any, ...]:
        options = {"name": self.name, **{name: getattr(self, name) for name in self.OPTIONS}}
        if self.encoders:
            options["encoder"] = self.encoders[0]
        return (_twin, type(self), options)


def _twin(cls: type[Compiled], options: dict[str, Any]) -> Compiled:
    return cls(**options)
