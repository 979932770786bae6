"""The present contents of a NOVA chip, for its lint. Each value is computed when it is read, as most writes need few."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from stage.chips.nova import core, state
from stage.chips.nova.interpolation import multichip
from stage.chips.register_map import Command

REFUSALS = {
    state.E_HLMT_PLUS: "LMT+ is active, drive the other way",
    state.E_HLMT_MINUS: "LMT- is active, drive the other way",
    state.E_SLMT_PLUS: "beyond the software limit +",
    state.E_SLMT_MINUS: "beyond the software limit -",
    state.E_ALARM: "ALARM is active",
    state.E_EMG: "EMG is active",
    state.F_STOP0: "STOP0 is active and enabled",
    state.F_STOP1: "STOP1 is active and enabled",
    state.F_STOP2: "STOP2 is active and enabled",
}
"""Error of RR2, or what has ended the drive -> why a drive does not begin."""
STOP3 = {state.F_STOP3: "STOP3 is active and enabled"}
"""Of a chip that has it: the bit is another cause in the other chips."""


class Held:
    """As `lint.Held`, of a record that is there."""

    def __init__(self, record: Any, axes: int, interpolated: Callable[..., int]):
        self._record, self._count, self._interpolated = record, axes, interpolated

    @cached_property
    def _axes(self) -> list[Any]:
        return list(self._record["ax"][: self._count])

    @property
    def wr6(self) -> int:
        return int(self._record["low"])

    @property
    def wr7(self) -> int:
        return int(self._record["high"])

    @property
    def unused(self) -> bool:
        return bool(self._record["unused"])

    @cached_property
    def driving(self) -> int:
        return sum(1 << k for k, x in enumerate(self._axes) if x["driving"] or x["interpolates"])

    def _fixed(self, absolute: int) -> int:
        """Axes in fixed-pulse driving, to an absolute position or not."""
        axes = enumerate(self._axes)
        return sum(1 << k for k, x in axes if self.driving >> k & 1 and x["fixed"] and x["absolute"] == absolute)

    @property
    def relative(self) -> int:
        return self._fixed(0)

    @property
    def absolute(self) -> int:
        return self._fixed(1)

    @property
    def interpolating(self) -> bool:
        return bool(self._record["interpolating"])

    @property
    def full(self) -> bool:
        queue = self._record["ip"]
        return self.interpolating and bool(queue["waiting"] >= queue["depth"])

    @property
    def bit_pattern(self) -> bool:
        return bool(self._record["ip"]["writing"])

    @property
    def interpolated(self) -> int:
        return self._interpolated()

    def interpolated_by(self, command: Command) -> int:
        """Return the axes that take part in an interpolation command, as bits."""
        return self.interpolated

    def refused(self, value: int) -> dict[int, str]:
        """Tried on a twin: the axes that do not begin to drive although they have pulses to make, with what RR2 says of it."""
        rows = self._record_copy()
        core.write(rows, 0, value)
        found = {}
        reasons = REFUSALS | STOP3 if self._record["extended"] else REFUSALS
        for k in range(self._count):
            x, after = self._axes[k], rows[0]["ax"][k]
            empty = after["fixed"] and after["output"] == 0
            asked = value >> 8 + k & 1 and not (x["held"] & 1 or empty or core.busy(rows, k))
            said = [text for bit, text in reasons.items() if int(after["causes"]) & bit]
            if asked and said:
                found[k] = ", ".join(said)
        return found

    def _record_copy(self) -> np.ndarray:
        rows = np.zeros(1, state.STATE)
        rows[0] = self._record
        return rows

    @property
    def role(self) -> int:
        """MLT of IPM."""
        return int(self._axes[0]["mode"][state.IPM]) >> multichip.MLT & 3

    @property
    def linked(self) -> bool:
        return bool(self._record["heard"])

    @property
    def started(self) -> bool:
        return bool(self._record["heard"] & multichip.GO)

    @property
    def drive_speed(self) -> tuple[int, ...]:
        return tuple(int(x["reg"][state.DV]) for x in self._record["ax"])

    @property
    def finish(self) -> tuple[int, ...]:
        return tuple(int(x["reg"][state.TP]) for x in self._record["ax"])

    @property
    def helix_ticks(self) -> int:
        return int(self._axes[0]["reg"][state.HLV])


class HeldOfMcx312(Held):
    """Its finish points have a sign, and its speeds no common unit."""

    @property
    def role(self) -> int:
        return 0

    @property
    def drive_speed(self) -> tuple[int, ...]:
        return ()

    @property
    def finish(self) -> tuple[int, ...]:
        return tuple(p - (p >> 31 << 32) for p in super().finish)


class HeldOfMcx314as(HeldOfMcx312):
    """WR5 names three axes; a command of two does not look at the third."""

    def interpolated_by(self, command: Command) -> int:
        return self._interpolated(max(command.together))
