"""Emulated motion-control chips, register for register. They know neither MuJoCo nor each other.

    from stage.chips import PCL240K, PCL240MK, PCL240MS

A family is a register map (data), a state record and a compiled core; see chip.py for what they share.
"""

from stage.chips.chip import Chip, Diagnostic, Snapshot
from stage.chips.pcl240 import PCL240K, PCL240MK, PCL240MS

CHIPS: dict[str, type[Chip]] = {cls.__name__: cls for cls in (PCL240K, PCL240MK, PCL240MS)}
"""Every chip by class name."""

__all__ = ["CHIPS", "PCL240K", "PCL240MK", "PCL240MS", "Chip", "Diagnostic", "Snapshot"]
