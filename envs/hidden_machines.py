"""Tasks on hidden machines: their common settings, their stage, and the machine of each episode.

@dataclass(frozen=True)
class Config(Machines):              split, model, chip, ranges, faults, bus_cycle and truth are there
    FAULTS = faulty.HAMPERING        of the faults of a split those that its machines may have

class MyTask(MachineTask[Config]):
    prepare:   self.prepare_machines()          `machines`, `ranges`, `faults` and `context`, (n,) CONTEXT
    begin:     self.draw_machine(k, options)
    step:      self.outfit(stage, k) after a stage was restored
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs import machine_contexts, machine_faults
from stage.envs.settings import AxisName, Cycle, Number, Pair, Payloads, Range, Settings, TruthOption, Word, Words
from stage.envs.task import ConfigT, MoveTask
from stage.errors import ArgumentError, unknown_name_error
from stage.sim.named_points import find_carrier


@dataclass(frozen=True)
class MachineSettings(Settings):
    """Settings that say where the machines of the episodes come from; None: as the split has it."""

    FAULTS: ClassVar[tuple[str, ...]] = machine_faults.HAMPERING
    """That machines of this task may have."""
    split: Annotated[str, Word(tuple(machine_contexts.SPLITS))] = "train"
    model: str | None = None
    chip: str | type[Chip] | None = None
    payloads: Payloads | None = None  # kg
    frictions: Annotated[Pair, Range(1e-3)] | None = None  # times the model's
    supplies: Annotated[Pair, Range(0.1, high=2.0)] | None = None  # times the nominal voltage
    currents: Annotated[Pair, Range(0.1, high=2.0)] | None = None  # times the current of the drive
    losses: Annotated[Pair, Range(0.01, high=10.0)] | None = None  # times the core loss of the motor
    inductances: Annotated[Pair, Range(0.1, high=10.0)] | None = None  # times the inductance of the motor
    drifts: Annotated[Pair, Range(0.0, high=0.5)] | None = None  # electrical turns, from try to try
    faults: Annotated[tuple[str, ...], Words(machine_faults.NAMES)] | None = None
    healthy: Annotated[float, Number(high=1.0)] = 0.0  # share of machines without a fault, where there are faults
    payload_on: AxisName | None = None  # body or site that carries it; None: see find_carrier
    bus_cycle: Cycle = 1e-6  # s
    truth: TruthOption = "info"  # where what no host can see is shown: observation_features.py

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.faults is not None and not self.faults:
            raise ArgumentError(f"faults={self.faults!r}: some of {', '.join(self.FAULTS)}; or say healthy=1.0.")
        for name in self.faults or ():
            if name not in self.FAULTS:
                raise unknown_name_error("fault of this task, in faults,", name, self.FAULTS)


class MachineTask(MoveTask[ConfigT]):
    """A task of steppers' slides on machines that the host does not know.

    Attributes: machines, an axis each, as the model has them; ranges of a context; faults, names that may be drawn; context, (n,).
    """

    context: np.ndarray

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes that take part."""
        c: Any = self.config
        return (c.axis,)

    def make_stage(self, visuals: bool) -> Stage:
        c: Any = self.config
        model, chip = (machine_contexts.get_setting(c, name) for name in ("model", "chip"))
        new_stage = Stage(model, chips=chip_class(chip), bus_cycle=c.bus_cycle, visuals=visuals)
        for name in self.axis_names:
            if name not in new_stage.axes:
                raise unknown_name_error(f"axis of model {model}", name, new_stage.axes)
            if new_stage.axes[name].drive.has_encoder or new_stage.axes[name].unit != "m":
                raise ArgumentError(f"axis {name}: it is no stepper's slide, and this task is of those.")
        return new_stage

    def prepare_machines(self) -> None:
        """Read the nominal machines from stages that nobody has changed; a subclass calls it in `prepare`."""
        c: Any = self.config
        first, names = self.stages[0], self.axis_names
        on = find_carrier(first, names[0], c.payload_on)
        self.machines = [machine_contexts.NominalMachine.from_stage(first, name, on) for name in names]
        self.faulty = [machine_faults.FaultyAxis.from_stage(first, name) for name in names]
        self.ranges = machine_contexts.get_context_ranges(c)
        self.faults = tuple(name for name in machine_contexts.get_setting(c, "faults") if name in c.FAULTS)
        self.context = np.zeros(self.n, machine_contexts.CONTEXT)

    def draw_machine(self, stage_index: int, options: Mapping[str, Any], axes: int | None = None) -> None:
        """Draw the machine of stage k's episode.

        Args:
            stage_index: Number of the stage.
            options: Of the reset.
            axes: Number of axes that may have a fault; default: all.
        """
        machine_contexts.draw_context(self.rngs[stage_index], self.ranges, self.context[stage_index], options)
        self.draw_fault(
            stage_index, options, self.make_fault_rng(stage_index), len(self.machines) if axes is None else axes
        )

    def make_fault_rng(self, stage_index: int) -> np.random.Generator:
        """Make a generator of numbers that do not change what stage k draws from now on."""
        bits: Any = self.rngs[stage_index].bit_generator
        return np.random.Generator(bits.jumped())

    def draw_fault(self, stage_index: int, options: Mapping[str, Any], rng: np.random.Generator, axes: int) -> None:
        c: Any = self.config
        machine_faults.draw_machine_fault(rng, self.faults, c.healthy, axes, self.context[stage_index])
        if "fault" in options:
            if options["fault"] not in (known := ("none", *c.FAULTS)):
                raise unknown_name_error("option fault", options["fault"], known)
            self.context[stage_index]["fault"] = machine_faults.NAMES.index(options["fault"])

    def configure_stage(
        self, stage: Stage, stage_index: int, extra_payload_kg: float = 0.0, bounce: float = 0.0
    ) -> None:
        """Make a stage the machine of stage k's episode.

        Args:
            stage: To change.
            stage_index: Number of the stage whose machine it becomes.
            extra_payload_kg: kg beyond the payload.
            bounce: Seconds for which the contact of ORG bounces.
        """
        context = self.context[stage_index]
        fault, at = int(context["fault"]), int(context["faulty"])
        for machine in self.machines:
            machine.apply(stage, context, extra_payload_kg + machine_faults.find_overload(fault))
        for j, axis in enumerate(self.faulty):
            axis.apply(stage, machine_faults.NAMES[fault if j == at else 0], bounce)

    def apply_machine(self, stage_index: int) -> None:
        self.configure_stage(self.stages[stage_index], stage_index)

    def describe_machine(self, stage_index: int) -> dict[str, Any]:
        """Return the machine of stage k for the info of a reset."""
        return {f.name: f.kind(self.context[stage_index][f.name]) for f in machine_contexts.INFO}

    @property
    def machine_info(self) -> dict[str, np.ndarray]:
        """Machines for the info of a step, by name."""
        return {f.name: self.context[f.name] for f in machine_contexts.INFO}

    @property
    def machine_features(self) -> np.ndarray:
        """Machines for an observation with truth=True, (n, features)."""
        return machine_contexts.scale_contexts(self.ranges, self.context)
