"""`TuningTask`: the common part of RegisterTuning and ServoTuning.

An action chooses the registers of one move of one axis. The distance, the payload and the angle of the rotor at the start are
drawn for each move.

A subclass defines its chip, its registers, the bus cycles of a move and the reward of a move.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np

from stage import Stage
from stage.chips import Chip, chip_class
from stage.envs.move_trials import StartPositions
from stage.envs.observation_features import HOST, TRUTH, Feature
from stage.envs.reduced_model import reduce_model
from stage.envs.register_scaling import RegisterBox
from stage.envs.scaling import scale_linear, scale_log
from stage.envs.settings import read_number_option
from stage.envs.task import MoveTask
from stage.errors import unknown_name_error
from stage.sim.payload_and_judged_point import find_payload_body
from stage.sim.program import Program
from stage.support import portable_math

ConfigT = TypeVar("ConfigT")

NEXT_MOVE_FEATURES = (
    Feature("distance", HOST, "distance of the next move, by its logarithm from -1 to 1 over `distances`"),
    Feature("payload", TRUTH, "payload of the next move, from -1 to 1 over `payloads`"),
)
"""Features of an observation that describe the next move."""


def make_move_info_features(unit: str, turn: str) -> tuple[Feature, ...]:
    """Describe the features of a drawn move in an info.

    Args:
        unit: Unit of a distance.
        turn: Meaning of an angle of 1.
    """
    return (
        Feature("distance", HOST, f"{unit}; in the info of a reset, those of the next move", kind=int),
        Feature("payload", TRUTH, "kg; in the info of a reset, that of the next move", kind=float),
        Feature(
            "angle",
            TRUTH,
            f"of the rotor at the start, from 0 to 1 {turn}; in the info of a reset, that of the next move",
            kind=float,
        ),
        Feature("registers", HOST, "registers of the action", kind=int),
    )


class TuningTask(MoveTask[ConfigT]):
    """Base of the tasks in which an action chooses the registers of one move.

    The Config of a subclass has at least `model`, `axis`, `reduced`, `actions` ("box" or "registers"), `distances` and `payloads`
    (ranges from which they are drawn), `payload_on`, `moves` (of an episode), `limit` (s, of a move) and `bus_cycle`.
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ("distance", "payload", "angle")
    """Options of a reset. angle: that of the rotor at the start, from 0 to 1 electrical turn; for a servo, encoder count."""
    STATE: ClassVar[tuple[str, ...]] = ("distance", "payload", "angle", "last")
    RESTARTS = True
    UNIT: ClassVar[str]
    """Unit of a distance."""

    def chip(self) -> type[Chip]:
        """Return the class of the axis' chip."""
        c: Any = self.config
        return chip_class(c.chip)

    @abstractmethod
    def make_register_box(self) -> RegisterBox:
        """Make the ranges of the registers that an action chooses. `axis` is already set."""

    @abstractmethod
    def make_program(self, row: np.ndarray, distance: int) -> Program:
        """Make the bus cycles of a move and of the observation after it. All programs have the same length.

        Args:
            row: Register values, in the order of `registers`.
            distance: Distance of the move, pulses, or counts for a servo.
        """

    def prepare_placed_move(self, stage_index: int) -> None:
        """Prepare a stage's next move after its carriage was put at the start. The base class does nothing."""

    def make_stage(self, visuals: bool) -> Stage:
        c: Any = self.config
        model = reduce_model(c.model, c.axis) if c.reduced else c.model
        new_stage = Stage(model, chips=self.chip(), bus_cycle=c.bus_cycle, visuals=visuals)
        if c.axis not in new_stage.axes:
            raise unknown_name_error("axis", c.axis, new_stage.axes)
        return new_stage

    def make_spaces_and_arrays(self) -> None:
        c: Any = self.config
        self.axis = self.stages[0].axes[c.axis]
        self.carrier = find_payload_body(self.stages[0], c.axis, c.payload_on)
        self.registers = self.make_register_box()
        self.action_space = self.registers.box if c.actions == "box" else self.registers.discrete
        self.starts = StartPositions(self.axis)
        self.starts.require_room(c.distances, self.UNIT)
        self.observation_space = self.make_observation_space()
        self.shapes = {"registers": (len(self.registers),)}
        self.distance, self.payload, self.angle = np.ones(self.n, np.int64), np.zeros(self.n), np.zeros(self.n)
        self.last = np.zeros((self.n, 4))
        self.make_program(self.registers.low, 1)

    def begin_episode(self, stage_index: int, options: Mapping[str, Any]) -> None:
        self.last[stage_index] = 0.0
        self._draw_move(stage_index, options)

    def prepare_next_step(self) -> None:
        for k in np.flatnonzero(self.undiverged_stages):
            self._draw_move(int(k), {})

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {
            "distance": int(self.distance[stage_index]),
            "payload": float(self.payload[stage_index]),
            "angle": float(self.angle[stage_index]),
        }

    def draw_distance(self, stage_index: int, options: Mapping[str, Any]) -> int:
        """Draw the distance of the next move of a stage. A subclass may override this method, and may return negative distances.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset; "distance" replaces a drawn one.

        Returns:
            Signed distance, pulses, or counts for a servo.
        """
        c: Any = self.config
        drawn = int(np.rint(portable_math.exp(self.rngs[stage_index].uniform(*portable_math.log(c.distances)))))
        return int(read_number_option(options, "distance", drawn, c.distances))

    def _draw_move(self, stage_index: int, options: Mapping[str, Any]) -> None:
        """Draw the distance, the payload and the rotor's angle of a stage's next move, and put the carriage at its start.

        Args:
            stage_index: Index of the stage.
            options: Options of the reset, which replace drawn values.
        """
        c: Any = self.config
        rng, stage = self.rngs[stage_index], self.stages[stage_index]
        distance = self.draw_distance(stage_index, options)
        self.payload[stage_index] = read_number_option(options, "payload", float(rng.uniform(*c.payloads)), c.payloads)
        self.distance[stage_index] = distance
        self.angle[stage_index] = read_number_option(options, "angle", float(rng.uniform()), (0.0, 1.0))
        stage.restore(self.start)
        self.apply_machine(stage_index)
        stage.place(
            **{c.axis: self.starts.find_start(float(self.distance[stage_index]), float(self.angle[stage_index]))}
        )
        self.prepare_placed_move(stage_index)

    def apply_machine(self, stage_index: int) -> None:
        self.stages[stage_index].set_payload(float(self.payload[stage_index]), self.carrier)

    def to_registers(self, actions: np.ndarray) -> np.ndarray:
        """Convert actions to register values, (n, registers)."""
        c: Any = self.config
        return self.registers.from_action(actions) if c.actions == "box" else actions.astype(np.int64)

    def make_programs(self) -> list[Program]:
        rows = self.to_registers(self.actions)
        return [self.make_program(row, int(d)) for row, d in zip(rows, self.distance, strict=True)]

    def set_move_results(
        self, parts: Mapping[str, np.ndarray], info: Mapping[str, np.ndarray], now: np.ndarray
    ) -> None:
        """Set the results of moves, and store the outcome for the next observation.

        Args:
            parts: Parts of the reward by name, (n,) each.
            info: Values of the info by name, (n, ...) each.
            now: Outcome of the move, as the next observation shows it, (n, 4).
        """
        c: Any = self.config
        good = self.undiverged_stages
        self.last[good] = np.clip(np.nan_to_num(now), 0.0, 1.0)[good]
        drawn = {
            "distance": self.distance,
            "payload": self.payload,
            "angle": self.angle,
            "registers": self.to_registers(self.actions),
        }
        self.set_results(parts, {**info, **drawn}, False, self.steps >= c.moves)

    def compute_observations(self) -> np.ndarray:
        c: Any = self.config
        drawn = np.stack(
            [scale_log(np.abs(self.distance), c.distances), scale_linear(self.payload, c.payloads)], axis=1
        )
        return np.clip(np.concatenate([drawn, self.last], axis=1), -1.0, 1.0).astype(np.float32)
