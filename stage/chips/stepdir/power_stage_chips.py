"""Chips of power stages with registers: STEP/DIR axes whose power stage can be configured by a bus and has further pins.

    chip = make_power_stage_chip("acme_power:AcmeAxis", "acme100")

Such a chip is a subclass of STEPDIR. Its core counts positions itself (`read_net_count`), in the microsteps of the axis' Drive,
gives the current (`read_motor_current`) and may take the load of the motor (`set_load`), see stage/chips/core_interface.py.
"""

from __future__ import annotations

from importlib import import_module

from stage.chips.stepdir import STEPDIR
from stage.errors import ArgumentError, LoadError


def make_power_stage_chip(where: str, name: str, clock_hz: int | None = None) -> STEPDIR:
    """Make the STEP/DIR chip of a power stage.

    Args:
        where: Attribute `chip` of the power stage; "": a plain STEPDIR.
        name: Name of the power stage, for messages.
        clock_hz: Reference clock, Hz.

    Raises:
        ArgumentError: It is no subclass of STEPDIR.
        LoadError: It cannot be imported.
    """
    if not where:
        return STEPDIR(clock_hz)
    module, _, class_name = where.partition(":")
    try:
        chip = getattr(import_module(module), class_name)
    except (Exception, SystemExit) as error:  # another maker's code
        raise LoadError(
            f"power stage {name}: its chip {where} cannot be loaded: {type(error).__name__}: {error}. Repair or uninstall the "
            "package that brings it; all other power stages work."
        ) from error
    if not isinstance(chip, type) or not issubclass(chip, STEPDIR):
        raise ArgumentError(
            f"power stage {name}: its chip {where} is {chip!r:.60}, and has to be a subclass of STEPDIR."
        )
    return chip(clock_hz)
