"""Tasks on hidden machines: their common settings, their stage, and the machine of each episode.

@dataclass(frozen=True)
class Config(MachineSettings):              has split, model, chip, ranges, faults, bus_cycle and truth
FAULTS = machine_faults.HAMPERING       the faults that machines of this task may have

class MyTask(MachineTask[Config]):
def make_spaces_and_arrays(self):
    self.prepare_contexts()             makes `machines`, `ranges`, `faults` and `context`
def begin_episode(self, stage_index, options):
    self.draw_machine(stage_index, options)
    self.apply_machine_to(self.stages[stage_index], stage_index)     also after each restore of the stage
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs import machine_contexts, machine_faults
from stage.envs.reduced_model import reduce_model
from stage.envs.settings import (
    AxisName,
    BusCycleSeconds,
    ChoiceSetting,
    ChoicesSetting,
    NumberSetting,
    Pair,
    PayloadRange,
    RangeSetting,
    Settings,
    TruthOption,
)
from stage.envs.task import ConfigT, MoveTask, Task
from stage.errors import ArgumentError, unknown_name_error
from stage.sim.payload_and_judged_point import find_payload_body


@dataclass(frozen=True)
class MachineSettings(Settings):
    """Settings that define from which distribution the machines of the episodes are drawn. None stands for the split's value.

    Attributes:
        split: Name of the distribution, a key of SPLITS.
        model: Name of the model.
        chip: Name or class of the chip.
        payloads: Smallest and largest payload, kg.
        frictions: Range of the factor on the friction and damping of the model.
        supplies: Range of the factor on the nominal supply voltage.
        currents: Range of the factor on the current of the drive.
        losses: Range of the factor on the core loss of the motor.
        inductances: Range of the factor on the inductance of the motor.
        drifts: Range of the largest drift of ORG between two attempts, in electrical turns.
        faults: Names of the faults that may be drawn.
        healthy: Share of the machines without a fault, for a split that has faults.
        payload_on: Body that carries the payload, or a site on it; None: see `find_payload_body`.
        bus_cycle: Duration of a bus cycle, s.
        truth: Whether observation and info have values that no host can know: True (both), "info" (info alone), False (neither).
    """

    FAULTS: ClassVar[tuple[str, ...]] = machine_faults.HAMPERING_FAULTS
    """Faults that machines of this task may have."""
    split: Annotated[str, ChoiceSetting(tuple(machine_contexts.SPLITS))] = "train"
    model: str | None = None
    chip: str | type[Chip] | None = None
    payloads: PayloadRange | None = None
    frictions: Annotated[Pair, RangeSetting(1e-3)] | None = None
    supplies: Annotated[Pair, RangeSetting(0.1, high=2.0)] | None = None
    currents: Annotated[Pair, RangeSetting(0.1, high=2.0)] | None = None
    losses: Annotated[Pair, RangeSetting(0.01, high=10.0)] | None = None
    inductances: Annotated[Pair, RangeSetting(0.1, high=10.0)] | None = None
    drifts: Annotated[Pair, RangeSetting(0.0, high=0.5)] | None = None
    faults: Annotated[tuple[str, ...], ChoicesSetting(machine_faults.FAULT_NAMES)] | None = None
    healthy: Annotated[float, NumberSetting(high=1.0)] = 0.0
    payload_on: AxisName | None = None
    bus_cycle: BusCycleSeconds = 1e-6
    truth: TruthOption = "info"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.faults is not None and not self.faults:
            raise ArgumentError(f"faults={self.faults!r}: some of {', '.join(self.FAULTS)}; or say healthy=1.0.")
        for name in self.faults or ():
            if name not in self.FAULTS:
                raise unknown_name_error("fault of this task, in faults,", name, self.FAULTS)


class HiddenMachineTask(Task[ConfigT]):
    """Base of the tasks on slides with stepper motors whose machine the host does not know.

    Attributes:
        machines: For each axis, the values of the model that a context changes.
        faulty: For each axis, the values that a fault changes.
        ranges: Smallest and largest value of each number of a context, by name.
        faults: Names of the faults that may be drawn.
        context: Context of each stage, CONTEXT records, (n,).
    """

    context: np.ndarray

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes that take part in the task."""
        c: Any = self.config
        return (c.axis,)

    def make_stage(self, visuals: bool) -> Stage:
        c: Any = self.config
        model, chip = (machine_contexts.get_split_setting(c, name) for name in ("model", "chip"))
        if getattr(c, "reduced", False):
            model = reduce_model(model, c.axis)
        new_stage = Stage(model, chips=chip_class(chip), bus_cycle=c.bus_cycle, visuals=visuals)
        for name in self.axis_names:
            if name not in new_stage.axes:
                raise unknown_name_error(f"axis of model {model}", name, new_stage.axes)
            if new_stage.axes[name].drive.has_encoder or new_stage.axes[name].unit != "m":
                raise ArgumentError(f"axis {name}: it is no stepper's slide, and this task is of those.")
        return new_stage

    def prepare_contexts(self) -> None:
        """Read the nominal machines from the first stage, before any context. Subclasses call this in `make_spaces_and_arrays`."""
        c: Any = self.config
        first, names = self.stages[0], self.axis_names
        on = find_payload_body(first, names[0], c.payload_on)
        self.machines = [machine_contexts.NominalMachine.from_stage(first, name, on) for name in names]
        self.faulty = [machine_faults.FaultyAxis.from_stage(first, name) for name in names]
        self.ranges = machine_contexts.get_context_ranges(c)
        self.faults = tuple(name for name in machine_contexts.get_split_setting(c, "faults") if name in c.FAULTS)
        self.context = np.zeros(self.n, machine_contexts.CONTEXT)

    def draw_machine(self, stage_index: int, options: Mapping[str, Any], axes: int | None = None) -> None:
        """Draw the machine of a stage's next episode.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset, which replace drawn values.
            axes: Number of axes that may have a fault; default: all.
        """
        machine_contexts.draw_context(self.rngs[stage_index], self.ranges, self.context[stage_index], options)
        self.draw_fault(
            stage_index, options, self.make_fault_rng(stage_index), len(self.machines) if axes is None else axes
        )

    def make_fault_rng(self, stage_index: int) -> np.random.Generator:
        """Make the generator that draws a stage's fault, without changing what the generator of the stage draws afterwards."""
        bits: Any = self.rngs[stage_index].bit_generator
        return np.random.Generator(bits.jumped())

    def draw_fault(self, stage_index: int, options: Mapping[str, Any], rng: np.random.Generator, axes: int) -> None:
        """Draw the fault of a stage's next episode.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset; "fault" names the fault instead.
            rng: Random generator.
            axes: Number of axes that may have the fault.
        """
        c: Any = self.config
        machine_faults.draw_machine_fault(rng, self.faults, c.healthy, axes, self.context[stage_index])
        if "fault" in options:
            if options["fault"] not in (known := ("none", *c.FAULTS)):
                raise unknown_name_error("option fault", options["fault"], known)
            self.context[stage_index]["fault"] = machine_faults.FAULT_NAMES.index(options["fault"])

    def apply_machine_to(
        self, stage: Stage, stage_index: int, extra_payload_kg: float = 0.0, bounce: float = 0.0
    ) -> None:
        """Apply the machine of an episode, with its fault, to a stage.

        Args:
            stage: Stage to change.
            stage_index: Index of the stage whose episode has the machine.
            extra_payload_kg: Mass beyond the payload, kg.
            bounce: Time for which the contact of ORG bounces, s.
        """
        context = self.context[stage_index]
        fault, at = int(context["fault"]), int(context["faulty"])
        name = machine_faults.FAULT_NAMES[fault]
        if name == "overload":
            extra_payload_kg += machine_faults.OVERLOAD_KG
        for machine in self.machines:
            machine.apply(stage, context, extra_payload_kg)
        for j, axis in enumerate(self.faulty):
            axis.apply(stage, name if j == at else "none", bounce)

    def apply_machine(self, stage_index: int) -> None:
        self.apply_machine_to(self.stages[stage_index], stage_index)

    def describe_machine(self, stage_index: int) -> dict[str, Any]:
        """Return the hidden machine of a stage for the info of a reset, as values by name."""
        return {f.name: f.kind(self.context[stage_index][f.name]) for f in machine_contexts.INFO_FEATURES}

    @property
    def machine_info(self) -> dict[str, np.ndarray]:
        """Hidden machines of all stages for the info of a step, as arrays by name."""
        return {f.name: self.context[f.name] for f in machine_contexts.INFO_FEATURES}

    @property
    def machine_features(self) -> np.ndarray:
        """Machines of all stages as numbers of an observation with truth=True, (n, features)."""
        return machine_contexts.scale_contexts(self.ranges, self.context)


class MachineTask(HiddenMachineTask[ConfigT], MoveTask[ConfigT]):
    """Hidden machine task whose step is a program that is judged after it was played."""
