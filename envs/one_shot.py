"""`stage/OneShotTuning-v1`: one try at a move, and its proof. The agent is told an estimate of the payload.

An episode is one machine and one distance, drawn as in FewShotTuning, whose moves, action, reward and proof this has: a step
chooses start rate, drive rate and both ramps; the move is made once, and proved with `margin` kg more. There is nothing to learn
within an episode: what counts is how bold one may be with what is known beforehand.

action        Box [-1, 1]^4, as FewShotTuning's; `action_of` of few_shot.py makes one of pps and seconds
observation   float32, -1 to 1: distance, by its logarithm; the declared payload over `payloads`, off by up to `error` of itself
              (truth=True adds the machine)
reward        gain, damage, proof, as FewShotTuning's: in sum log(2 x usual time / proved cost), or 0 where it does not hold; less
              `damage_weight` for steps lost or an end limit hit
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
from stage.envs.scaling import scale, scale_log
from stage.envs.settings import Count, Number, Word, read_option
from stage.envs.stage_env import StageEnv, StageVectorEnv
from stage.errors import ArgumentError


@dataclass(frozen=True)
class Config(few_shot.Config):
    """Settings of OneShotTuning: those of FewShotTuning, with one try, and how well the payload is known."""

    tries: Count = 1
    memory: Annotated[str, Word(few_shot.MEMORIES)] = "last"
    error: Annotated[float, Number(high=0.9)] = 0.2  # of the payload, by which the declared one is off at most

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tries != 1:
            raise ArgumentError(f"tries={self.tries!r}: one here; stage/FewShotTuning-v1 has several.")


class OneShotTuning(FewShotTuning):
    Config = Config
    OPTIONS = (*FewShotTuning.OPTIONS, "declared")
    """The move and the machine, and the payload that is declared, in place of drawn ones."""
    STATE = (*FewShotTuning.STATE, "declared")
    OBSERVATION = (
        FewShotTuning.OBSERVATION[0],
        Feature("declared", HOST, "payload as declared, from -1 to 1 over `payloads`"),
        *machine_contexts.OBSERVATION,
    )
    INFO = (Feature("declared", HOST, "kg; in the info of a reset"), *FewShotTuning.INFO)

    def prepare(self) -> None:
        super().prepare()
        self.declared = np.zeros(self.n)

    def layout(self) -> list[Feature]:
        return list(self.OBSERVATION)

    def _compute_formula(self, stage_index: int, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        off = 1 + self.config.error * rng.uniform(-1, 1)  # type: ignore[attr-defined]
        largest = self.ranges["payload"][1]
        drawn = min(float(self.context[stage_index]["payload"]) * off, largest)
        self.declared[stage_index] = read_option(options, "declared", drawn, (0.0, largest))
        self._set_formula(stage_index, float(self.declared[stage_index]))

    def describe_episode(self, stage_index: int) -> dict[str, Any]:
        return {"declared": float(self.declared[stage_index]), **super().describe_episode(stage_index)}

    def compute_observations(self) -> np.ndarray:
        distance = scale_log(self.distance, self.config.distances)
        declared = scale(self.declared, self.ranges["payload"])
        columns = [np.stack([distance, declared], axis=1), self.machine_features]
        return np.clip(np.concatenate(columns, axis=1), -1.0, 1.0).astype(np.float32)


class OneShotTuningEnv(StageEnv):
    task = OneShotTuning


class OneShotTuningVectorEnv(StageVectorEnv):
    task = OneShotTuning
