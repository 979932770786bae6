"""Tools for pytest tests of motion firmware: a plugin (fixtures `stage`, `board`, `host`, see plugin.py) and assertions.

    @pytest.mark.stage(model="xy", chips="PCL240MS")
    @pytest.mark.firmware("driver.c")
    def test_the_driver_homes_x(stage, host):
        assert host.run(timeout=20).code == 0
        assert_at(stage.axes["x"], -0.12, within=100e-6)
        assert_no_lost_steps(stage)

`chip_conformance` tests a chip itself. pytest imports this package in every session, so it loads its modules only when they are
used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stage.testing.assertions import (
        assert_at,
        assert_no_diagnostics,
        assert_no_lost_steps,
        assert_no_strays,
        assert_pins,
        assert_stopped,
    )
    from stage.testing.conformance import chip_conformance
    from stage.testing.path_assertion import assert_path_within
    from stage.testing.power_stage_promises import power_stage_conformance

__all__ = [
    "assert_at", "assert_no_diagnostics", "assert_no_lost_steps", "assert_no_strays", "assert_path_within", "assert_pins",
    "assert_stopped", "chip_conformance", "power_stage_conformance",
]  # fmt: skip
_MODULE_BY_NAME = {
    "assert_path_within": "path_assertion",
    "chip_conformance": "conformance",
    "power_stage_conformance": "power_stage_promises",
}


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(import_module(f"stage.testing.{_MODULE_BY_NAME.get(name, 'assertions')}"), name)
    raise AttributeError(f"module 'stage.testing' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
