"""Binaries of other machines on emulated processors, whose bus is a board: TargetHost. See docs/targets.md."""

from stage.targets.host import TargetHost
from stage.targets.mcus import NoEmulatorError

__all__ = ["NoEmulatorError", "TargetHost"]
