"""PulseStage: emulated motion-control chips drive a stage in MuJoCo, register for register.

    from stage import Stage, firmware
    from stage.chips import PCL240K

    stage = Stage("xyz", chips=PCL240K)
    print(firmware.origin_return(stage.axes["x"]))

Importing this package is cheap: MuJoCo and the compiled loop load with the first `Stage`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError, ModelError, RunTimeout, SimulationError, StageError

if TYPE_CHECKING:
    from stage import firmware
    from stage.drives.motors import Drive, Motor
    from stage.machine import Snapshot, Stage

__version__ = "0.1.0"

_LAZY = {
    "Stage": "stage.machine",
    "Snapshot": "stage.machine",
    "Drive": "stage.drives.motors",
    "Motor": "stage.drives.motors",
}

__all__ = [
    "ArgumentError", "Drive", "ModelError", "Motor", "RunTimeout", "SimulationError", "Snapshot", "Stage", "StageError",
    "firmware",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "firmware":
        return import_module("stage.firmware")
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'stage' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
