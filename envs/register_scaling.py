"""Scaling of registers to actions: a number from -1 to 1 for each register, and back without loss.

    box = RegisterBox.of_registers(PCL240K.MAP, ("R1", "R2", "R4", "R5", "R6", "R7"))
    box.from_action(action)      int64 register values, each in its legal range
    box.to_action(registers)     float32 in [-1, 1]; `from_action` of these returns the registers, exactly (for the MCX514 to
                                 2 in a million, because its registers hold more values than a float32)

With u = (a + 1) / 2, from 0 to 1, a register between low and high is

    low (high / low)^u           if low > 0: speeds, rates and multipliers matter by their ratios
    low + (high - low) u^3       if low is 0 and the range is wide (R6): small values matter most
    low + (high - low) u         if low is 0 and the range is narrow (spans of S-curves)

rounded. The range of R6 is 0 to 1,048,575 for every chip: a float32 cannot distinguish more values, and no move here is longer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import gymnasium
import numpy as np

from stage.chips.register_map import RegisterMap
from stage.errors import ArgumentError
from stage.firmware.parameter_ranges import get_register_range
from stage.support import portable_math

WIDE_RANGE = 1 << 16


class RegisterBox:
    """Ranges of some registers, with the conversion between their values and actions from -1 to 1.

    Args:
        names: Names of the registers.
        ends: Smallest and largest value of each register.
        cubed: Names of registers in whose range small values matter most, in addition to all wide ranges.
    """

    def __init__(self, names: Sequence[str], ends: Iterable[tuple[int, int]], cubed: Sequence[str] = ()):
        self.names = tuple(names)
        self.low, self.high = (np.array(side, np.int64) for side in zip(*ends, strict=True))
        self._logarithmic = self.low > 0
        self._ratio = np.where(self._logarithmic, portable_math.log(self.high / np.maximum(self.low, 1)), 1.0)
        self._power = np.where((self.high > WIDE_RANGE) | np.isin(self.names, cubed), 3.0, 1.0)

    @classmethod
    def of_registers(cls, map_: RegisterMap, names: Sequence[str]) -> RegisterBox:
        """Make the box of actions for some registers of a chip.

        Args:
            map_: Register map of the chip.
            names: Names of the registers.
        """
        return cls(names, [get_register_range(map_, name) for name in names])

    def __len__(self) -> int:
        return len(self.names)

    @property
    def box(self) -> gymnasium.spaces.Box:
        """Action space of numbers from -1 to 1, one for each register."""
        return gymnasium.spaces.Box(-1.0, 1.0, (len(self),), np.float32)

    @property
    def discrete(self) -> gymnasium.spaces.MultiDiscrete:
        """Action space of the register values themselves."""
        return gymnasium.spaces.MultiDiscrete(self.high - self.low + 1, start=self.low)

    def from_action(self, action: np.ndarray) -> np.ndarray:
        """Convert actions from -1 to 1, (..., n), to int64 register values, (..., n)."""
        u = (np.clip(np.asarray(action, np.float64), -1.0, 1.0) + 1.0) / 2.0
        scaled = np.where(
            self._logarithmic,
            self.low * portable_math.exp(self._ratio * u),
            self.low + (self.high - self.low) * portable_math.power(u, self._power),
        )
        return np.clip(np.rint(scaled), self.low, self.high).astype(np.int64)

    def to_action(self, registers: np.ndarray | Mapping[str, int]) -> np.ndarray:
        """Convert register values to actions.

        Args:
            registers: Values, (..., n), or a mapping from name to value.

        Returns:
            Actions, (..., n) float32.

        Raises:
            ArgumentError: A value is out of its range.
        """
        values = [registers[n] for n in self.names] if isinstance(registers, Mapping) else registers
        r = np.asarray(values, np.int64)
        if (r < self.low).any() or (r > self.high).any():
            ranges = ", ".join(f"{n} {a}..{b}" for n, a, b in zip(self.names, self.low, self.high, strict=True))
            raise ArgumentError(f"registers {values!r}: out of range; {ranges}.")
        with np.errstate(divide="ignore"):
            u = np.where(
                self._logarithmic,
                portable_math.log(r / np.maximum(self.low, 1)) / self._ratio,
                portable_math.power((r - self.low) / (self.high - self.low), 1.0 / self._power),
            )
        return (2.0 * u - 1.0).astype(np.float32)

    def to_dict(self, registers: np.ndarray) -> dict[str, int]:
        """Return one row of register values as a dict by register name."""
        return {n: int(v) for n, v in zip(self.names, registers, strict=True)}
