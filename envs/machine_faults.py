"""Faults that the machine of an episode may have, drawn by name; stage/sim/faults.py explains their physics.

draw_machine_fault(rng, names, 0.6, 1, context)      draws a fault, or none with a probability of 0.6
healthy = FaultyAxis.from_stage(stage, "x")          reads the axis without a fault
healthy.apply(stage, "org open")                     makes the fault; "none" clears it
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage import Stage
from stage.drives import stepper
from stage.errors import ArgumentError
from stage.sim.faults import DEFAULT_JAM_FACTOR, JAM_SOLIMP

FAULTS = {
    "none": "",
    "org open": "the ORG switch is stuck open: it never trips",
    "org closed": "the ORG switch is stuck closed: it never lets go",
    "jam": "the axis is jammed: it does not move",
    "phase open": "a wire to the motor is broken",
    "brownout": "the supply is down to 3 % of its voltage",
    "binding": "the bearings bind: more dry friction, a quarter of what the motor can push at its most",
    "sag": "the supply sags to 60 % of its voltage",
    "overload": "12 kg were left on the table",
    "bounce": "the contact of ORG bounces for 1 ms",
}
FAULT_NAMES = tuple(FAULTS)
"""Names of the faults; a context holds the index of its fault in this tuple."""
DISABLING_FAULTS = FAULT_NAMES[1:6]
"""Faults with which an axis cannot make its moves; a host can only detect and report them."""
HAMPERING_FAULTS = ("binding", "sag", "overload")
"""Faults with which an axis still moves, but worse than a healthy one; slower moves avoid the effects."""
BROWNOUT, SAG = 0.03, 0.6  # supply voltage, as a share of its healthy value
BINDING_FRICTION_SHARE = 0.25  # additional friction, as a share of the motor's largest force
OVERLOAD_KG = 12.0  # additional payload, kg
BOUNCE, TOGGLES = 1e-3, 6  # duration of a bounce, s; number of level changes in it
_FORCED_ORG_LEVELS = {"org open": 0, "org closed": 1}
_SUPPLY = {"brownout": BROWNOUT, "sag": SAG}
_FRICTION_SHARES = {"jam": DEFAULT_JAM_FACTOR, "binding": BINDING_FRICTION_SHARE}


def draw_machine_fault(rng: np.random.Generator, names: Sequence[str], healthy: float, axes: int, context: Any) -> None:
    """Draw the fault of a hidden machine: none with the probability `healthy`, else one of `names` on one of the axes.

    Args:
        rng: Random generator.
        names: Names of the faults that may be drawn.
        healthy: Probability of no fault.
        axes: Number of axes that may have the fault.
        context: Record to fill.
    """
    broken, which = rng.uniform() >= healthy, int(rng.integers(0, max(len(names), 1)))
    context["fault"] = FAULT_NAMES.index(names[which]) if broken and names else 0
    context["faulty"] = rng.integers(0, axes) if axes > 1 else 0


@dataclass(frozen=True)
class FaultyAxis:
    """Axis whose faults can be made and cleared, with the values that it has without a fault.

    Attributes:
        axis: Name of the axis.
        row: Row of its ORG switch in the stage's table of switches; None without ORG.
        forced: State to which ORG is forced in the healthy machine; -1 if it is not forced.
        solref: Reference parameters of the joint's friction constraint (MuJoCo's dof_solref).
        solimp: Impedance parameters of the joint's friction constraint (MuJoCo's dof_solimp).
        phases: Bit mask of the motor phases that are open.
        push: Largest force of the motor on the joint, N.
    """

    axis: str
    row: int | None
    forced: int
    solref: np.ndarray
    solimp: np.ndarray
    phases: int
    push: float

    @classmethod
    def from_stage(cls, stage: Stage, axis: str) -> FaultyAxis:
        """Read an axis from a stage on which no fault has been made.

        Args:
            stage: Stage at power-up.
            axis: Name of the axis.
        """
        a, model = stage.axes[axis], stage.model
        row = a.switches.find_index("org") if any(s.pin == "org" for s in a.plant.switches) else None
        dof, forced = a.plant.dof, -1 if row is None else int(stage.state.switch_table[row]["forced"])
        push = a.drive.peak_torque * abs(a.gear)
        return cls(
            axis, row, forced, model.dof_solref[dof].copy(), model.dof_solimp[dof].copy(), a.faults.open_phases, push
        )

    def apply(self, stage: Stage, name: str, bounce: float = 0.0) -> None:
        """Make one fault on the axis and clear all others.

        Call this after the hidden machine has been applied, which sets the same values of the axis.

        Args:
            stage: Stage to change.
            name: Name of the fault; "none" clears all faults.
            bounce: Time for which the contact of ORG bounces, s.

        Raises:
            ArgumentError: The fault is of an ORG switch, and the axis has none.
        """
        axis: Any = stage.axes[self.axis]
        model, dof = stage.model, axis.plant.dof
        jammed, bounce = name == "jam", BOUNCE if name == "bounce" else bounce
        model.dof_solref[dof] = (2 * model.opt.timestep, 1) if jammed else self.solref
        model.dof_solimp[dof] = JAM_SOLIMP if jammed else self.solimp
        if name in _FRICTION_SHARES:
            model.dof_frictionloss[dof] += _FRICTION_SHARES[name] * self.push
        axis.faults.open_phases = self.phases | (stepper.A if name == "phase open" else 0)
        if name in _SUPPLY:
            axis.faults.bus_voltage *= _SUPPLY[name]
        if self.row is not None:
            switch = stage.state.switch_table[self.row]
            switch["forced"] = _FORCED_ORG_LEVELS.get(name, self.forced)
            switch["bounce"], switch["toggles"] = round(bounce * 1e9), TOGGLES if bounce else 0
        elif name in _FORCED_ORG_LEVELS or bounce:
            raise ArgumentError(f"fault {name!r}: axis {self.axis} has no ORG switch.")
        stage.apply_faults()
        stage.update_switches(axis)
