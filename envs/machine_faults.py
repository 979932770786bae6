"""Faults that the machine of an episode may have, drawn by name; stage/sim/faults.py explains their physics.

draw(rng, names, 0.6, 1, context)       which a machine has, if any
faults = Faulty.of(stage, "x")          the axis as it is without
faults.put(stage, "org open")           and with; "none" mends it
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
NAMES = tuple(FAULTS)
"""A context keeps a fault by its number in here."""
DISABLING = NAMES[1:6]
"""With these an axis does not do what it is told; a host can only notice and say so."""
HAMPERING = ("binding", "sag", "overload")
"""With these it still moves, but not as a healthy one; all can be worked around by slower moves."""
BROWNOUT, SAG = 0.03, 0.6  # of the voltage
BINDING = 0.25  # of what the motor can push
OVERLOAD = 12.0  # kg
BOUNCE, TOGGLES = 1e-3, 6  # s; of a bouncing contact
_SWITCH = {"org open": 0, "org closed": 1}
_SUPPLY = {"brownout": BROWNOUT, "sag": SAG}
_PUSH = {"jam": DEFAULT_JAM_FACTOR, "binding": BINDING}


def draw_machine_fault(rng: np.random.Generator, names: Sequence[str], healthy: float, axes: int, context: Any) -> None:
    """Draw the fault of a context: none with the probability `healthy`, else one of `names`, on one of `axes` axes.

    Args:
        rng: Random generator.
        names: Of the faults that may be drawn.
        healthy: Probability of no fault.
        axes: Number of axes that may have it.
        context: Record to fill.
    """
    broken, which = rng.uniform() >= healthy, int(rng.integers(0, max(len(names), 1)))
    context["fault"] = NAMES.index(names[which]) if broken and names else 0
    context["faulty"] = rng.integers(0, axes) if axes > 1 else 0


def find_overload(fault: int) -> float:
    """Return the mass on the table beyond the payload, kg."""
    return OVERLOAD if NAMES[fault] == "overload" else 0.0


@dataclass(frozen=True)
class FaultyAxis:
    """The parts of an axis that faults change, as a healthy machine has them, after its context was put on."""

    axis: str
    row: int | None
    forced: int
    solref: np.ndarray
    solimp: np.ndarray
    phases: int
    push: float

    @classmethod
    def from_stage(cls, stage: Stage, axis: str) -> FaultyAxis:
        """Read the parts of an axis from a stage that nobody has changed.

        Args:
            stage: At power-up.
            axis: Its name.
        """
        a, model = stage.axes[axis], stage.model
        row = a.switches.row("org") if any(s.pin == "org" for s in a.plant.switches) else None
        dof, forced = a.plant.dof, -1 if row is None else int(stage.state.switch_table[row]["forced"])
        push = a.drive.peak_torque * abs(a.gear)
        return cls(
            axis, row, forced, model.dof_solref[dof].copy(), model.dof_solimp[dof].copy(), a.faults.open_phases, push
        )

    def apply(self, stage: Stage, name: str, bounce: float = 0.0) -> None:
        """Give the machine this fault and no other, after its context was applied.

        Args:
            stage: To change.
            name: Of the fault; "none" clears it.
            bounce: Seconds for which the contact of ORG bounces.

        Raises:
            ArgumentError: The fault is of a switch that the axis does not have.
        """
        axis: Any = stage.axes[self.axis]
        model, dof = stage.model, axis.plant.dof
        jammed, bounce = name == "jam", BOUNCE if name == "bounce" else bounce
        model.dof_solref[dof] = (2 * model.opt.timestep, 1) if jammed else self.solref
        model.dof_solimp[dof] = JAM_SOLIMP if jammed else self.solimp
        if name in _PUSH:
            model.dof_frictionloss[dof] += _PUSH[name] * self.push
        axis.faults.open_phases = self.phases | (stepper.A if name == "phase open" else 0)
        if name in _SUPPLY:
            axis.faults.bus_voltage *= _SUPPLY[name]
        if self.row is not None:
            switch = stage.state.switch_table[self.row]
            switch["forced"] = _SWITCH.get(name, self.forced)
            switch["bounce"], switch["toggles"] = round(bounce * 1e9), TOGGLES if bounce else 0
        elif name in _SWITCH or bounce:
            raise ArgumentError(f"fault {name!r}: axis {self.axis} has no ORG switch.")
        stage.apply_faults()
        stage.update_switches(axis)
