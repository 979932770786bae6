"""PulseStage: emulated motion-control chips drive a stage in MuJoCo, register for register.

    from stage import Stage, firmware
    from stage.chips import PCL240K

    machine = Stage("xyz", chips=PCL240K)
    print(firmware.origin_return(machine.axes["x"]))

Importing this package is cheap: MuJoCo and the compiled loop load with the first `Stage`.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError, LoadError, ModelError, NativeError, RunTimeout, SimulationError, StageError

if TYPE_CHECKING:
    from stage import firmware
    from stage.drives.motors import Drive, Motor
    from stage.sim import faults
    from stage.sim.fleet import Fleet
    from stage.sim.program import Program
    from stage.sim.stage import Snapshot, Stage
    from stage.support.extras import ExtraMissing
    from stage.support.snapshot_files import SnapshotError

__version__ = "0.1.0"

_LAZY_EXPORTS = {
    "Stage": "stage.sim.stage",
    "Snapshot": "stage.sim.stage",
    "SnapshotError": "stage.support.snapshot_files",
    "ExtraMissing": "stage.support.extras",
    "Fleet": "stage.sim.fleet",
    "Program": "stage.sim.program",
    "Drive": "stage.drives.motors",
    "Motor": "stage.drives.motors",
}
_METHODS_OF_STAGE = {"record": "stage.recording:Recording", "panel": "stage.panel:open"}
"""Conveniences of `Stage` that packages above stage.sim provide: method -> what is called with the stage and its arguments."""
_PACKAGES = "agents board chips drives envs errors firmware recording study testing units".split()
_MODULES = {"faults": "stage.sim.faults"} | {name: f"stage.{name}" for name in _PACKAGES}

__all__ = [
    "ArgumentError", "Drive", "ExtraMissing", "Fleet", "LoadError", "ModelError", "Motor", "NativeError", "Program", "RunTimeout",
    "SimulationError", "Snapshot", "SnapshotError", "Stage", "StageError", "faults", "firmware",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return _load_module(_MODULES[name])
    if name in _LAZY_EXPORTS:
        return getattr(_load_module(_LAZY_EXPORTS[name]), name)
    raise AttributeError(f"module 'stage' has no attribute {name!r}")


def load_method_of_stage(name: str) -> Any:
    """Load the function or class behind a method of `Stage` that another package implements, such as `record` or `panel`."""
    module, _, attribute = _METHODS_OF_STAGE[name].partition(":")
    return getattr(_load_module(module), attribute)


def _load_module(module: str) -> Any:
    """Import a module of this package.

    Raises:
        LoadError: The import raises AttributeError, which Python would report as "cannot import name", without the cause.
    """
    try:
        return import_module(module)
    except StageError:
        raise
    except (AttributeError, ImportError, OSError, RuntimeError) as error:
        gl = os.environ.get("MUJOCO_GL")
        hint = f" MUJOCO_GL={gl} wants a GL library of MuJoCo, which may not be here: unset it." if gl else ""
        raise LoadError(f"{module} cannot be loaded: {type(error).__name__}: {error}.{hint}") from error


def __dir__() -> list[str]:
    return sorted(__all__)
