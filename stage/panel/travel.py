"""Whether the carriages are where their machine lets them be. No page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stage.units import PLACES

if TYPE_CHECKING:
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

YIELD = 0.1  # of the travel: an end stop is MuJoCo's, which gives way a little; a hard blow goes in by 3 % of it
MOST = 2.0  # times what the motor can push at its most


def has_ends(axis: Axis) -> bool:
    """It has end limits, and stops behind them; a table that turns without end has not."""
    return any(switch.pin.startswith("el") for switch in axis.plant.switches)


def outside(stage: Stage) -> str:
    """Which carriage has gone through its end stop, and how far, in words; "": none."""
    for axis in stage.axes.values():
        if not has_ends(axis):
            continue
        at, (low, high) = float(stage.data.qpos[axis.plant.qpos]), axis.travel
        room = YIELD * (high - low)
        if not low - room <= at <= high + room:
            place = PLACES[axis.unit]
            return (
                f"{axis.name} is out of its travel, at {place.text(at, '.4g')}: its end stops are at {place.text(low, 'g')} and "
                f"{place.text(high, 'g')}. Take the cause away, and go back to a good state."
            )
    return ""


def strongest_push(axis: Axis) -> float:
    """N (N m on a hinge) with which a hand may push an axis: enough to tear it from its motor, whatever that does. With much more
    the carriage would go through its end stop."""
    return MOST * axis.drive.peak_torque * abs(axis.gear)
