"""Hidden machines of episodes: the values that the host does not know, their ranges by split, and how they are drawn.

    SPLITS["train"]            settings by name; another split names only what differs from train
    context = np.zeros((), CONTEXT)
    draw_context(rng, ranges, context, options)
    NominalMachine.from_stage(stage, "x", carrier).apply(stage, context)

A context includes the fault of the machine, which machine_faults.py draws and makes. hidden_machine_task.py has the common part of
all tasks on hidden machines. A snapshot of a stage contains only two values of a context, the current and the inductance of the
drive. The task applies the context again after it has restored a stage.
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
from stage.envs.scaling import scale_linear
from stage.envs.settings import read_number_option
from stage.native import record
from stage.support import portable_math


def _compute_tolerance_factors(value: str) -> tuple[float, float]:
    """Compute the smallest and largest value of a motor property, as factors on its nominal value.

    Args:
        value: Attribute of the motor of the shipped models, such as "inductance".
    """
    motor = MOTORS["17HS4401"]
    nominal, (low, high, _) = getattr(motor, value), estimate_tolerances(motor)[value]
    return round(low / nominal, 2), round(high / nominal, 2)


SPLITS: dict[str, dict[str, Any]] = {
    "train": {
        "model": "xyz", "chip": "PCL240K", "payloads": (0.0, 5.0), "frictions": (0.5, 2.0), "supplies": (0.7, 1.1),
        "currents": (0.6, 1.0), "losses": _compute_tolerance_factors("core_loss_damping"),
        "inductances": _compute_tolerance_factors("inductance"),
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
"""Distributions of contexts by name. A policy may learn from "train"; the others test it. Values that a split does not name are
those of train. Of the faults, a task uses only those in `FAULTS` of its Config; only DriftingHome uses the faults of train.

A switch or potentiometer of the drive sets the current, which scales the torque up to the speed at which the supply limits the
current. Above that speed, core loss and inductance limit the torque. Their ranges in train are the tolerances of the shipped
models' motor (stage/drives/motor_tolerances.py). Those in weak begin where the tolerances end. Its largest loss, 9e-4 N m s/rad,
is that of the motor whose curve is published."""

CONTEXT_NUMBERS = {
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
"""Numbers of a context: name -> (setting with its range; "" for 0 to 1, meaning)."""
LOGARITHMIC_NUMBERS = ("friction", "loss")
"""Numbers of a context that are drawn evenly by their logarithm; all others are drawn evenly."""

CONTEXT = record([(name, "f8") for name in CONTEXT_NUMBERS] + [("fault", "i8"), ("faulty", "i8")])
"""Numbers of a context; fault: index in machine_faults.NAMES, 0 for none; faulty: index of the axis that has the fault."""
RESET_OPTION_NAMES = (*CONTEXT_NUMBERS, "fault")
"""Values of a machine that options of a reset can set."""
INFO_FEATURES = (
    *(Feature(name, TRUTH, f"{text}, of the episode", kind=float) for name, (_, text) in CONTEXT_NUMBERS.items()),
    Feature("fault", TRUTH, "number of the machine's fault in machine_faults.NAMES, 0 for none", kind=int),
)
"""Features of a machine in an info."""

OBSERVATION_FEATURES = (
    *(Feature(name, TRUTH, f"{text}, from -1 to 1 over its range") for name, (_, text) in CONTEXT_NUMBERS.items()),
    Feature("fault", TRUTH, "1 if the machine has a fault"),
)
"""Features of a machine in an observation with truth=True; `scale_contexts` computes them."""


def get_split_setting(config: Any, name: str) -> Any:
    """Return a setting of a Config; if it is None, return the value of the Config's split.

    Args:
        config: Settings with the attribute `split`; None stands for train.
        name: Name of the setting.
    """
    value = getattr(config, name)
    return SPLITS[config.split or "train"].get(name, SPLITS["train"][name]) if value is None else value


def get_context_ranges(config: Any) -> dict[str, tuple[float, float]]:
    """Return the smallest and largest value of each number of a context (hidden machine), by name."""
    unit_range = (0.0, 1.0)
    return {
        name: get_split_setting(config, kind) if kind else unit_range for name, (kind, _) in CONTEXT_NUMBERS.items()
    }


def draw_context(
    rng: np.random.Generator, ranges: Mapping[str, tuple[float, float]], context: Any, options: Mapping[str, Any]
) -> None:
    """Draw the numbers of a context (hidden machine), evenly over their ranges; LOGARITHMIC_NUMBERS by their logarithm.

    Args:
        rng: Random generator. Each number is drawn even if an option replaces it, so that an option changes no other number.
        ranges: Smallest and largest value of each number, by name.
        context: Record to fill.
        options: Values that replace drawn ones, by name.

    Raises:
        ArgumentError: An option is out of its range.
    """
    for name, (low, high) in ranges.items():
        drawn = (
            portable_math.exp(rng.uniform(*portable_math.log((low, high))))
            if name in LOGARITHMIC_NUMBERS
            else rng.uniform(low, high)
        )
        context[name] = read_number_option(options, name, float(drawn), (low, high))


def scale_contexts(ranges: Mapping[str, tuple[float, float]], context: np.ndarray) -> np.ndarray:
    """Scale the numbers of contexts (hidden machines) for an observation.

    Args:
        ranges: Smallest and largest value of each number, by name.
        context: CONTEXT records, (n,).

    Returns:
        Each number from -1 to 1 over its range, and 1 for a machine with a fault, (n, len(OBSERVATION_FEATURES)).
    """
    numbers = [scale_linear(context[name], span) for name, span in ranges.items()]
    return np.stack([*numbers, context["fault"] != 0], axis=1)


@dataclass(frozen=True)
class NominalMachine:
    """Values of an axis in the model of a stage, which a context multiplies or replaces.

    Attributes:
        axis: Name of the axis.
        carrier: Name of the body that carries the payload.
        friction: Dry friction of the joint, N (N m on a hinge).
        damping: Damping of the joint, N s/m (N m s/rad on a hinge).
        supply: Supply voltage, V.
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
        """Read the values of an axis from a stage that no context has changed.

        Args:
            stage: Stage at power-up.
            axis: Name of the axis.
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
        """Apply a context (hidden machine) to a stage. Call this again after each restore, which resets the drive.

        Args:
            stage: Stage to change.
            context: CONTEXT record.
            extra_payload_kg: Mass in addition to the payload of the context, kg.
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
