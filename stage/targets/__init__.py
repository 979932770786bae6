"""Binaries of other machines on emulated processors, whose bus is a board: TargetHost. See docs/targets.md."""

from stage.targets.supported_processors import NoEmulatorError
from stage.targets.target_host import TargetHost

__all__ = ["NoEmulatorError", "TargetHost"]
