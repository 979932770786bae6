"""`stage/OneShotTuning-v1`: one attempt at a move, and its proof. The agent knows an estimate of the payload.

An episode is one machine and one distance. Machines, moves, actions, reward and proof are those of FewShotTuning: a step chooses
the start rate, the drive rate and both ramps; the move is made once, and proved with `margin` kg more. An agent learns nothing
within an episode. It has to find out in training how fast a move may be for what it knows before the move.

action        Box [-1, 1]^4, as FewShotTuning's; `make_action` of few_shot.py makes one from pps and seconds
observation   float32, -1 to 1: distance, by its logarithm; the declared payload over `payloads`, wrong by up to a share of
              `error` (truth=True adds the machine)
reward        gain, damage, proof and deposit, as FewShotTuning's: in sum log(2 x usual time / proved cost), or 0 if the proof
              fails; less `damage_weight` for lost steps or an end limit
episode       one step, then terminated.
score         time: s, the proved cost. formula: the engineer's (stage.tune.formula) for the declared payload, in closed form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from stage.envs import few_shot, machine_contexts
from stage.envs.few_shot import FewShotTuning
from stage.envs.observation_features import HOST, Feature
from stage.envs.scaling import scale_linear, scale_log
from stage.envs.settings import ChoiceSetting, Count, NumberSetting, read_number_option
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.errors import ArgumentError


@dataclass(frozen=True)
class Config(few_shot.Config):
    """Settings of OneShotTuning: those of FewShotTuning with one attempt, and the accuracy of the declared payload.

    Attributes:
        tries: Number of attempts, always 1.
        memory: "last", because there is one attempt.
        error: Largest deviation of the declared payload, as a share of the payload.
    """

    tries: Count = 1
    memory: Annotated[str, ChoiceSetting(few_shot.MEMORIES)] = "last"
    error: Annotated[float, NumberSetting(high=0.9)] = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tries != 1:
            raise ArgumentError(f"tries={self.tries!r}: one here; stage/FewShotTuning-v1 has several.")


class OneShotTuning(FewShotTuning):
    """Rules of stage/OneShotTuning-v1. The module docstring states them."""

    Config = Config
    OPTIONS = (*FewShotTuning.OPTIONS, "declared")
    """Options of a reset, which replace drawn values of the move, the machine and the declared payload."""
    STATE = (*FewShotTuning.STATE, "declared")
    OBSERVATION = (
        FewShotTuning.OBSERVATION[0],
        Feature("declared", HOST, "payload as declared, from -1 to 1 over `payloads`"),
        *machine_contexts.OBSERVATION_FEATURES,
    )
    INFO = (Feature("declared", HOST, "kg; in the info of a reset"), *FewShotTuning.INFO)

    def make_spaces_and_arrays(self) -> None:
        super().make_spaces_and_arrays()
        self.declared = np.zeros(self.n)

    def list_all_features(self) -> list[Feature]:
        return list(self.OBSERVATION)

    def _compute_formula_move(self, stage_index: int, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Draw the declared payload of one stage, and compute the move of the engineer's formula for it."""
        off = 1 + self.config.error * rng.uniform(-1, 1)  # type: ignore[attr-defined]
        largest = self.ranges["payload"][1]
        drawn = min(float(self.context[stage_index]["payload"]) * off, largest)
        self.declared[stage_index] = read_number_option(options, "declared", drawn, (0.0, largest))
        self._store_formula_move(stage_index, float(self.declared[stage_index]))

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"declared": float(self.declared[stage_index]), **super().describe_episode(stage_index)}

    def compute_observations(self) -> np.ndarray:
        distance = scale_log(self.distance, self.config.distances)
        declared = scale_linear(self.declared, self.ranges["payload"])
        columns = [np.stack([distance, declared], axis=1), self.machine_features]
        return np.clip(np.concatenate(columns, axis=1), -1.0, 1.0).astype(np.float32)


class OneShotTuningEnv(StageEnv):
    """Gymnasium environment stage/OneShotTuning-v1: choose the rates and ramps of a move in one attempt."""

    task = OneShotTuning


class OneShotTuningVectorEnv(StageVectorEnv):
    """Vector environment stage/OneShotTuning-v1: choose the rates and ramps of a move in one attempt."""

    task = OneShotTuning
