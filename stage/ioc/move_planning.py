"""`PlannedMove`: soft limits and backlash takeout of a move, by the documentation of the EPICS motor record. No EPICS here."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlannedMove:
    """Move of a motor record in dial units, with its backlash takeout.

    Attributes:
        target: Position to reach.
        present: Position at the beginning.
        backlash: Signed distance of the takeout (BDST): the last part of a move has its sign.
        step: Smallest distance that the motor can move; a shorter backlash is none.
        has_one_speed: Whether takeout and move have the same speed and ramp.
    """

    target: float
    present: float
    backlash: float
    step: float
    has_one_speed: bool

    @property
    def is_in_takeout_direction(self) -> bool:
        """True if the move has the direction of the takeout."""
        return (self.target > self.present) == (self.backlash > 0)

    def is_allowed(self, low: float, high: float) -> bool:
        """Return whether soft limits allow the move, with its takeout; limits of 0 and 0 allow every move.

        Args:
            low: Lower soft limit (DLLM).
            high: Upper soft limit (DHLM).
        """
        if low == high == 0:
            return True
        if low > high:
            return False
        if high < self.target < self.present or self.present < self.target < low:
            return True  # from outside of the limits towards them
        furthest = self.target if self.is_in_takeout_direction else self.target - self.backlash
        return low <= furthest <= high

    def list_stages(self) -> list[tuple[float, bool]]:
        """Return the positions to go to one after the other, each with whether the takeout's speed applies."""
        if abs(self.backlash) < self.step or (self.is_in_takeout_direction and self.has_one_speed):
            return [(self.target, False)]
        if self.is_in_takeout_direction and abs(self.target - self.present) <= abs(self.backlash) + self.step:
            return [(self.target, True)]
        return [(self.target - self.backlash, False), (self.target, True)]
