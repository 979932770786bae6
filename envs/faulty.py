"""Faults of a machine that an episode may have, drawn by name; see stage/sim/faults.py for what each is in the physics.

faults = Faulty.of(stage, "x")          the axis as it is without
faults.put(stage, "org open")           and with; "none" mends it
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stage import Stage
from stage.drives import stepper
from stage.sim.faults import JAM, STIFF

FAULTS = {
    "none": "",
    "org open": "the ORG switch is stuck open: it never trips",
    "org closed": "the ORG switch is stuck closed: it never lets go",
    "jam": "the axis is jammed: it does not move",
    "phase open": "a wire to the motor is broken",
    "brownout": "the supply is down to 3 % of its voltage",
}
NAMES = tuple(FAULTS)
"""A context keeps a fault by its number in here."""
BROWNOUT = 0.03
TOGGLES = 6  # of a bouncing contact
_SWITCH = {"org open": 0, "org closed": 1}


@dataclass(frozen=True)
class Faulty:
    """The parts of an axis that faults change, as a healthy machine has them, after its context was put on."""

    axis: str
    row: int
    forced: int
    solref: np.ndarray
    solimp: np.ndarray
    phases: int
    push: float

    @classmethod
    def of(cls, stage: Stage, axis: str) -> Faulty:
        """Of a stage that nobody has changed, whose axis has an ORG switch."""
        a, model = stage.axes[axis], stage.model
        row, dof = a.switches.row("org"), a.plant.dof
        push = JAM * a.drive.peak_torque * abs(a.gear)
        forced = int(stage.state.switch_table[row]["forced"])
        return cls(axis, row, forced, model.dof_solref[dof].copy(), model.dof_solimp[dof].copy(), a.open_phases, push)

    def put(self, stage: Stage, name: str, bounce: float = 0.0) -> None:
        """The machine has this fault and no other, and the contact of ORG bounces for so many seconds. Call it after the context
        was put on: friction and supply are the context's."""
        axis: Any = stage.axes[self.axis]
        model, dof = stage.model, axis.plant.dof
        jammed = name == "jam"
        model.dof_solref[dof] = (2 * model.opt.timestep, 1) if jammed else self.solref
        model.dof_solimp[dof] = STIFF if jammed else self.solimp
        if jammed:
            model.dof_frictionloss[dof] += self.push
        axis.open_phases = self.phases | (stepper.A if name == "phase open" else 0)
        if name == "brownout":
            axis.supply *= BROWNOUT
        switch = stage.state.switch_table[self.row]
        switch["forced"] = _SWITCH.get(name, self.forced)
        switch["bounce"], switch["toggles"] = round(bounce * 1e9), TOGGLES if bounce else 0
        stage.equip()
        stage.look_again(axis)
