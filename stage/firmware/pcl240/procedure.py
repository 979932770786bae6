"""`Procedure` of the PCL-240 family: with a port, and with R0 at the end."""

from __future__ import annotations

from stage.firmware import report
from stage.firmware.axis import Axis
from stage.firmware.pcl240.bus import Port, check


class Procedure(report.Procedure):
    """Watches an axis whose chip is of the family. Raises ArgumentError for another."""

    def __init__(self, axis: Axis, name: str):
        check(axis)
        super().__init__(axis, name)
        self.port = Port(axis)

    def residual(self) -> int:
        return self.port.counter()
