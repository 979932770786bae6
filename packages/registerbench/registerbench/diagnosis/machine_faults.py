"""Faults of the machines of broken set-ups, made at each power-up, and the services of a technician that repair them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stage import Stage
from stage.envs.machine_faults import FaultyAxis

SERVICES = {
    "exchange the wires of the end limits of x": "swapped limit switches",
    "set the supply of the drives to what is on the nameplate": "supply too low",
    "tighten the coupling between motor and screw of x": "slipping coupling",
    "replace the motor of x": "broken motor wire",
    "clean and grease the guides of x": "jammed guides",
    "replace the ORG sensor of x": "stuck ORG sensor",
}
"""Services of a technician, and the cause that each repairs."""
LIMIT_PINS = ("el_plus", "el_minus")
DEFAULT_SEVERITIES = {"supply too low": 1 / 6, "slipping coupling": 1 / 15}
"""Shares of the supply voltage, and of the motor's torque that reaches the screw, of the named set-ups."""


class FaultyMachine:
    """Machine of a set-up, whose faults can be made and repaired.

    Args:
        stage: Stage at power-up, without faults.
    """

    def __init__(self, stage: Stage):
        self._stage, self._axis = stage, stage.axes["x"]
        self._healthy = FaultyAxis.from_stage(stage, "x")
        self._friction = stage.model.dof_frictionloss.copy()
        self._volts = {name: axis.faults.bus_voltage for name, axis in stage.axes.items()}
        self._torque = np.array([drive.torque_constant for drive in stage.state.drives])

    def make_faults(self, faults: Mapping[str, float]) -> None:
        """Make exactly these faults; all others are repaired. Call it at power-up.

        Args:
            faults: Causes, each with its severity: the share of the voltage or of the torque that is left; for a stuck ORG sensor,
                below 0.5 it never trips, otherwise it never lets go.
        """
        stage, x = self._stage, self._axis
        stage.model.dof_frictionloss[:] = self._friction
        for name, axis in stage.axes.items():
            axis.faults.bus_voltage = self._volts[name] * faults.get("supply too low", 1.0)
        self._healthy.apply(stage, _find_standstill_fault(faults))
        org = stage.state.switch_table[self._healthy.row]
        org["forced"] = int(faults["stuck ORG sensor"] >= 0.5) if "stuck ORG sensor" in faults else self._healthy.forced
        wires = [x.chip.find_switch_input(pin) for pin in LIMIT_PINS]
        for pin, bit in zip(LIMIT_PINS, wires[:: -1 if "swapped limit switches" in faults else 1], strict=True):
            stage.state.switch_table[x.switches.find_index(pin)].bit = bit
        stage.update_switches(x)
        if "slipping coupling" in faults:  # the model has no rotor apart from the screw
            drive = stage.state.drives[x.index]
            drive.torque_constant, drive.slice = self._torque[x.index] * faults["slipping coupling"], 0.0


def _find_standstill_fault(faults: Mapping[str, float]) -> str:
    """Return the fault of machine_faults.FAULTS with which the axis stands still; "none" if it has none of them."""
    return "jam" if "jammed guides" in faults else "phase open" if "broken motor wire" in faults else "none"
