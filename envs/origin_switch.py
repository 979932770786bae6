"""`OriginSwitch`: the ORG switch of an axis, which environments shift, and the end limits of that axis."""

from __future__ import annotations

from stage import Stage
from stage.errors import ArgumentError
from stage.sim.axis import Axis


class OriginSwitch:
    """ORG switch of an axis, which can be shifted, and the positions of the end limits.

    Args:
        stage: Stage on which no ORG switch has been shifted.
        axis: Axis of the stage.

    Attributes:
        position: Position at which ORG trips, m.
        low, high: Positions at which the end limits trip, m.

    Raises:
        ArgumentError: The axis lacks one of the switches.
    """

    def __init__(self, stage: Stage, axis: Axis):
        switches = {s.pin: s for s in axis.plant.switches}
        for pin in ("org", "el_minus", "el_plus"):
            if pin not in switches:
                raise ArgumentError(f"axis {axis.name} has no {pin}: an origin return needs ORG and both end limits.")
        self.position, self.low, self.high = (float(switches[pin].touch) for pin in ("org", "el_minus", "el_plus"))
        self._beam = int(stage.model.sensor_refid[switches["org"].sensor])
        body = stage.data.xmat[stage.model.geom_bodyid[self._beam]].reshape(3, 3)
        self._direction = body.T @ stage.data.xaxis[axis.joint]  # of the travel, in the frame of the beam's body
        self._nominal = stage.model.geom_pos[self._beam].copy()

    def shift(self, stage: Stage, distance: float) -> None:
        """Shift the ORG switch of a stage along the travel of the axis.

        Args:
            stage: Stage to change, with the same model.
            distance: Signed distance from the nominal position, m.
        """
        stage.model.geom_pos[self._beam] = self._nominal + self._direction * distance
