"""Hidden contexts: what a machine is that the host does not know, drawn for each episode; and splits, named places to draw from.

    SPLITS["train"]            settings by name; every other split is the same but for what it names
    context = np.zeros((), CONTEXT)
    draw(rng, ranges, context, options); Machine.of(stage, "x", carrier).equip(stage, context)

Which fault a machine has is part of its context: faulty.py draws and makes them. machines.py has what tasks on hidden machines
share. A context is the machine's: a stage's snapshots leave all of it alone but the current and the inductance, which the drive
has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage import Stage
from stage.drives.motors import MOTORS
from stage.drives.spread import estimate_spread
from stage.envs.features import TRUTH, Feature
from stage.envs.settings import read_option
from stage.native import record
from stage.support import portable


def _compute_factors(value: str) -> tuple[float, float]:
    """Compute the spread of a value over the nominal one, for the motor of the shipped models."""
    motor = MOTORS["17HS4401"]
    nominal, (low, high, _) = getattr(motor, value), estimate_spread(motor)[value]
    return round(low / nominal, 2), round(high / nominal, 2)


SPLITS: dict[str, dict[str, Any]] = {
    "train": {
        "model": "xyz", "chip": "PCL240K", "payloads": (0.0, 5.0), "frictions": (0.5, 2.0), "supplies": (0.7, 1.1),
        "currents": (0.6, 1.0), "losses": _compute_factors("core_loss_damping"), "inductances": _compute_factors("inductance"),
        "drifts": (0.0, 0.1), "faults": ("org open", "org closed"),
    },
    "heavy": {"payloads": (5.0, 10.0)},
    "worn": {"frictions": (2.0, 4.0)},
    "weak": {"supplies": (0.5, 0.7), "currents": (0.4, 0.6), "losses": (1.8, 2.5), "inductances": (1.2, 1.4)},
    "loose": {"drifts": (0.1, 0.5)},
    "ms": {"chip": "PCL240MS"},
    "nova": {"chip": "MCX514"},
    "mast": {"model": "xy_mast"},
    "faults": {"faults": ("jam", "phase open", "brownout", "binding", "sag", "overload", "bounce")},
}  # fmt: skip
"""Where contexts come from: of "train" a policy may learn, the others test it. All that a split does not name is as in train. A
task takes those of the faults that its machines may have (`FAULTS` of its Config): none of train, but for DriftingHome.

The current, which a drive's switch or potentiometer sets, scales the torque up to the speed where the supply limits the current.
Above that speed loss and inductance count. Those of train are the spread of the shipped models' motor (stage/drives/spread.py);
those of weak begin where it ends, up to a loss of 9e-4 N m s/rad, which is that of the motor whose curve is published."""

KINDS = {
    "payload": ("payloads", "kg on the table"),
    "friction": ("frictions", "times the friction and damping of the axis"),
    "supply": ("supplies", "times the nominal voltage of the drive"),
    "current": ("currents", "times the current of the drive"),
    "loss": ("losses", "times the core loss of the motor"),
    "inductance": ("inductances", "times the inductance of the motor"),
    "switch": ("", "where ORG trips, hence each try begins, in electrical turns of the motor, from 0 to 1"),
    "drift": ("drifts", "electrical turns by which ORG trips earlier or later from try to try, at most"),
}
"""Of a context: its setting, and what it is."""
LOGARITHMIC = ("friction", "loss")
"""Parts that are drawn evenly by their logarithm; the others are drawn evenly."""

CONTEXT = record([(name, "f8") for name in KINDS] + [("fault", "i8"), ("faulty", "i8")])
"""fault: its number in faulty.NAMES, 0 for none; faulty: which of the task's axes has it."""
OPTIONS = (*KINDS, "fault")
"""Parts of a machine that `reset(options=...)` takes."""
INFO = (
    *(Feature(name, TRUTH, f"{text}, of the episode", kind=float) for name, (_, text) in KINDS.items()),
    Feature("fault", TRUTH, "number of the machine's fault in faulty.NAMES, 0 for none", kind=int),
)
"""Features of a machine in an info."""

OBSERVATION = (
    *(Feature(name, TRUTH, f"{text}, from -1 to 1 over its range") for name, (_, text) in KINDS.items()),
    Feature("fault", TRUTH, "1 if the machine has a fault"),
)
"""Features of a machine in an observation with truth=True; `scale_contexts` computes them."""


def get_setting(config: Any, name: str) -> Any:
    """A setting of a Config that has a split: its own value, or where that is None the split's."""
    own = getattr(config, name)
    return SPLITS[config.split].get(name, SPLITS["train"][name]) if own is None else own


def get_ranges(config: Any) -> dict[str, tuple[float, float]]:
    """(least, most) of each number of a context."""
    whole = (0.0, 1.0)
    return {name: get_setting(config, kind) if kind else whole for name, (kind, _) in KINDS.items()}


def draw_context(
    rng: np.random.Generator, ends: Mapping[str, tuple[float, float]], context: Any, options: Mapping[str, Any]
) -> None:
    """Fill a CONTEXT: evenly, those of LOGARITHMIC by their logarithm, but for those in `options`. Raises ArgumentError for one
    beyond its ends. All are drawn in any case, so that what is given changes no other."""
    for name, (low, high) in ends.items():
        drawn = portable.exp(rng.uniform(*portable.log((low, high)))) if name in LOGARITHMIC else rng.uniform(low, high)
        context[name] = read_option(options, name, float(drawn), (low, high))


def scale_contexts(ends: Mapping[str, tuple[float, float]], context: np.ndarray) -> np.ndarray:
    """(n, SHOWN): contexts from -1 to 1 over their ranges, and whether there is a fault."""
    numbers = [(context[name] - a) / max(b - a, 1e-9) * 2.0 - 1.0 for name, (a, b) in ends.items()]
    return np.stack([*numbers, context["fault"] != 0], axis=1)


@dataclass(frozen=True)
class NominalMachine:
    """An axis of a stage as its model has it, before a context makes it another."""

    axis: str
    carrier: str
    friction: float
    damping: float
    supply: float
    current: float
    loss: float
    inductance: float

    @classmethod
    def from_stage(cls, stage: Stage, axis: str, carrier: str) -> NominalMachine:
        """Of a stage that nobody has changed."""
        a, model = stage.axes[axis], stage.model
        dof = a.plant.dof
        friction, damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
        loss = float(model.actuator_damping[a.plant.actuator])
        drive = stage.state.drives[a.index]
        current, inductance = float(drive.current), float(drive.inductance)
        return cls(axis, carrier, friction, damping, float(a.faults.bus_voltage), current, loss, inductance)

    def apply(self, stage: Stage, context: Any, more: float = 0.0) -> None:
        """The stage is the machine of a CONTEXT; more: kg beyond its payload. After a stage was restored, for the drive."""
        axis = stage.axes[self.axis]
        dof, drive = axis.plant.dof, stage.state.drives[axis.index]
        stage.set_payload(float(context["payload"]) + more, self.carrier)
        stage.model.dof_frictionloss[dof] = self.friction * context["friction"]
        stage.model.dof_damping[dof] = self.damping * context["friction"]
        axis.faults.bus_voltage = self.supply * float(context["supply"])
        stage.model.actuator_damping[axis.plant.actuator] = self.loss * context["loss"]
        drive.current = self.current * context["current"]
        drive.inductance, drive.slice = self.inductance * context["inductance"], 0.0
        stage.apply_faults()
