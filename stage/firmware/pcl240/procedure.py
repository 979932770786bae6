"""`Procedure` of the PCL-240 family: with a port, and with R0 at the end."""

from __future__ import annotations

from stage.firmware import report
from stage.firmware.axis import Axis
from stage.firmware.pcl240.bus import Port, check
from stage.firmware.pcl240.stop_reason import find_stop_reason
from stage.firmware.stop_reasons import UNKNOWN


class Procedure(report.Procedure):
    """Watches an axis whose chip is of the family. Raises ArgumentError for another."""

    def __init__(self, axis: Axis, name: str):
        check(axis)
        super().__init__(axis, name)
        self.port = Port(axis)

    def stop_reason(self) -> str:
        """Return what ended the axis' last run, see `find_stop_reason`; UNKNOWN where no start has reached the chip."""
        return find_stop_reason(self.journal) or UNKNOWN

    def residual(self) -> int:
        return self.port.counter()
