"""Hidden machines of episodes: the values that the host does not know, their ranges by split, and how they are drawn.

    SPLITS["train"]            settings by name; every other split is the same but for what it names
    context = np.zeros((), CONTEXT)
    draw_context(rng, ranges, context, options)
    NominalMachine.from_stage(stage, "x", carrier).apply(stage, context)

Which fault a machine has is part of its context: machine_faults.py draws and makes them. hidden_machines.py has what tasks on
hidden machines share. A context is the machine's: a stage's snapshots leave all of it alone but the current and the inductance,
which the drive has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stage import Stage
from stage.drives.motor_tolerances import estimate_tolerances
from stage.drives.motors import MOTORS
from stage.envs.observation_features import TRUTH, Feature
from stage.envs.scaling import scale
from stage.envs.settings import read_option
from stage.native import record
from stage.support import portable_math


def _compute_factors(value: str) -> tuple[float, float]:
    """Compute the spread of a value over the nominal one, for the motor of the shipped models."""
    motor = MOTORS["17HS4401"]
    nominal, (low, high, _) = getattr(motor, value), estimate_tolerances(motor)[value]
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

The current, which a drive's switch or potentiometer sets, scales the torque up to the speed where the supply limits the
current. Above that speed loss and inductance count. Those of train are the spread of the shipped models' motor
(stage/drives/motor_tolerances.py); those of weak begin where it ends, up to a loss of 9e-4 N m s/rad, which is that of the
motor whose curve is published."""

KINDS = {
    "payload": ("payloads", "kg on the table"),
    "friction": ("frictions", "times the friction and damping of the axis"),
    "supply": ("supplies", "times the nominal voltage of the drive"),
    "current": ("currents", "times the current of the drive"),
    "loss": ("losses", "times the core loss of the motor"),
    "inductance": ("inductances", "times the inductance of the motor"),
    "switch": ("", "place where ORG trips and each attempt begins, in electrical turns of the motor, from 0 to 1"),
    "drift": (
        "drifts",
        "largest number of electrical turns by which ORG trips earlier or later from attempt to attempt",
    ),
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
    """Return a setting of a Config that has a split: the value of the Config, or that of the split if it is None.

    Args:
        config: Settings with the attribute `split`.
        name: Of the setting.
    """
    value = getattr(config, name)
    return SPLITS[config.split].get(name, SPLITS["train"][name]) if value is None else value


def get_context_ranges(config: Any) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value of each number of a context."""
    unit_range = (0.0, 1.0)
    return {name: get_setting(config, kind) if kind else unit_range for name, (kind, _) in KINDS.items()}


def draw_context(
    rng: np.random.Generator, ends: Mapping[str, tuple[float, float]], context: Any, options: Mapping[str, Any]
) -> None:
    """Draw the numbers of a context: evenly, those of LOGARITHMIC by their logarithm.

    Args:
        rng: Random generator; each number is drawn in any case, so that an option changes no other number.
        ends: Least and largest value by name.
        context: Record to fill.
        options: Values in place of drawn ones.

    Raises:
        ArgumentError: An option is beyond its ends.
    """
    for name, (low, high) in ends.items():
        drawn = (
            portable_math.exp(rng.uniform(*portable_math.log((low, high))))
            if name in LOGARITHMIC
            else rng.uniform(low, high)
        )
        context[name] = read_option(options, name, float(drawn), (low, high))


def scale_contexts(ends: Mapping[str, tuple[float, float]], context: np.ndarray) -> np.ndarray:
    """Scale contexts for an observation.

    Args:
        ends: Least and largest value by name.
        context: Records, (n,).

    Returns:
        Numbers from -1 to 1 over their ranges, and 1 for a machine with a fault, (n, OBSERVATION).
    """
    numbers = [scale(context[name], span) for name, span in ends.items()]
    return np.stack([*numbers, context["fault"] != 0], axis=1)


@dataclass(frozen=True)
class NominalMachine:
    """Values of an axis in the model of a stage, which a context multiplies or replaces.

    Attributes:
        axis: Name of the axis.
        carrier: Name of the body that carries the payload.
        friction: Friction of the joint, N (N m on a hinge).
        damping: Damping of the joint, N s/m (N m s/rad on a hinge).
        supply: Voltage of the supply, V.
        current: Current of the power stage, A.
        loss: Core loss damping of the motor, N m s/rad.
        inductance: Inductance of a winding, H.
    """

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
        """Read the values of an axis from a stage that nobody has changed.

        Args:
            stage: At power-up.
            axis: Its name.
            carrier: Name of the body that carries the payload.
        """
        a, model = stage.axes[axis], stage.model
        dof = a.plant.dof
        friction, damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
        loss = float(model.actuator_damping[a.plant.actuator])
        drive = stage.state.drives[a.index]
        current, inductance = float(drive.current), float(drive.inductance)
        return cls(axis, carrier, friction, damping, float(a.faults.bus_voltage), current, loss, inductance)

    def apply(self, stage: Stage, context: Any, extra_payload_kg: float = 0.0) -> None:
        """Make the stage the machine of a context. After a restore it has to be done again, for the drive.

        Args:
            stage: To change.
            context: Record of CONTEXT.
            extra_payload_kg: kg beyond the payload of the context.
        """
        axis = stage.axes[self.axis]
        dof, drive = axis.plant.dof, stage.state.drives[axis.index]
        stage.set_payload(float(context["payload"]) + extra_payload_kg, self.carrier)
        stage.model.dof_frictionloss[dof] = self.friction * context["friction"]
        stage.model.dof_damping[dof] = self.damping * context["friction"]
        axis.faults.bus_voltage = self.supply * float(context["supply"])
        stage.model.actuator_damping[axis.plant.actuator] = self.loss * context["loss"]
        drive.current = self.current * context["current"]
        drive.inductance, drive.slice = self.inductance * context["inductance"], 0.0
        stage.apply_faults()
