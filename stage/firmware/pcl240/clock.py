"""Whose clock a chip of the PCL-240 family counts: its own, or by SYNI that behind another chip's multiplier R7.

A follower's own R7 does nothing. So its rates are planned with the leader's, and where the leader makes no clock nothing moves.
"""

from __future__ import annotations

from typing import Any

from stage.errors import StageError
from stage.firmware.axis import Axis

LEAST = 2
"""The smallest R7 that makes a clock."""


def name_leader(axis: Axis) -> str:
    """Return the leader of an axis' chip in words: "axis x"."""
    leader = getattr(axis.chip, "syni", None)
    everyone: Any = getattr(getattr(axis, "stage", None), "axes", {})
    return next((f"axis {name}" for name, other in everyone.items() if other.chip is leader), "another chip")


def read_leader_multiplier(axis: Axis) -> int | None:
    """Return the R7 that the axis' chip hears at SYNI; None where it counts its own clock."""
    leader = getattr(axis.chip, "syni", None)
    return None if leader is None else int(leader.state["reg"][7])


def require_clock(axis: Axis) -> int | None:
    """Return `read_leader_multiplier`. Raises StageError where the leader makes no clock."""
    multiplier = read_leader_multiplier(axis)
    if multiplier is not None and multiplier < LEAST:
        raise StageError(f"axis {axis.name} makes no pulses: {explain_silence(axis)}")
    return multiplier


def explain_silence(axis: Axis) -> str:
    """Return why the axis' chip makes no pulses, whatever starts it; "" where it has a clock."""
    multiplier = read_leader_multiplier(axis)
    if multiplier is not None and multiplier < LEAST:
        leader = name_leader(axis)
        return (
            f"its chip counts the clock of {leader} (SYNI), whose R7 is {multiplier}, and R7 = 2 to 1023 make a clock. "
            f"Write the R7 of {leader}, move both together, or disconnect SYNI."
        )
    if multiplier is None and (own := int(axis.chip.state["reg"][7])) < LEAST:
        return f"its R7 is {own}, and R7 = 2 to 1023 make a clock. Write R7."
    return ""
