"""Players that are shipped with the benchmark, which a new method should beat."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.envs import few_shot

if TYPE_CHECKING:
    from registerbench.policies import Policy, PolicyContext


class RandomPolicy:
    """Policy that draws uniformly random actions; if there is an action mask, among the allowed ones."""

    def __init__(self, seed: int):
        self.seed = seed
        self.space: Any = None

    def reset(self, policy_context: PolicyContext) -> None:
        if self.space is None:
            self.space = policy_context.action_space
            self.space.seed(self.seed)

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        mask = info.get("action_mask")
        return self.space.sample() if mask is None else self.space.sample(mask=np.asarray(mask, np.int8))


class ScriptedPolicy:
    """Policy of the task's own scripted host, which does not learn."""

    def reset(self, policy_context: PolicyContext) -> None:
        self.env = policy_context.env

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return self.env.scripted_action()


class FixedSpeedFactorPolicy:
    """Policy of few-shot with one speed factor for all attempts: the usual speeds times it, the usual ramps divided by it."""

    def __init__(self, speed_factor: float):
        self.speed_factor = speed_factor

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return compute_scaled_action(self.speed_factor)


class SpeedFactorSearch:
    """Policy of few-shot that searches for the largest speed factor at which the encoder shows no lost step.

    It multiplies the speed factor by STEP_FACTOR until an attempt fails, then tries between the fastest success and the slowest
    failure (at BISECTION_SHARE of the way, on a logarithmic scale), until a step gains less than MIN_GAIN_FACTOR.
    """

    STEP_FACTOR, BISECTION_SHARE, MIN_GAIN_FACTOR, RETREAT_FACTOR, FIRST_SPEED_FACTOR = 1.12, 0.5, 1.1, 1.4, 3.4 / 1.12

    def reset(self, policy_context: PolicyContext) -> None:
        self.kept_indices = [k for k, name in enumerate(policy_context.feature_names) if name == "kept"]
        self.fastest_success: float | None = None
        self.slowest_failure, self.latest, self.attempts = np.inf, self.FIRST_SPEED_FACTOR, 0

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        if self.attempts:
            self._update_bounds(observation[self.kept_indices[min(self.attempts, len(self.kept_indices)) - 1]] > 0)
        self.attempts += 1
        return compute_scaled_action(self.latest)

    def _update_bounds(self, in_step: bool) -> None:
        if in_step:
            self.fastest_success = max(self.fastest_success or 0.0, self.latest)
        else:
            self.slowest_failure = min(self.slowest_failure, self.latest)
        if self.fastest_success is not None and self.fastest_success >= self.slowest_failure:
            self.fastest_success = None  # the same speed factor also failed, so its success was luck
        if self.fastest_success is None:
            self.latest = self.slowest_failure / self.RETREAT_FACTOR
            return
        between = self.fastest_success ** (1 - self.BISECTION_SHARE) * self.slowest_failure**self.BISECTION_SHARE
        faster = self.fastest_success * self.STEP_FACTOR if np.isinf(self.slowest_failure) else between
        self.latest = faster if faster > self.fastest_success * self.MIN_GAIN_FACTOR else self.fastest_success


class FinalTrySpeedFactorSearch(SpeedFactorSearch):
    """Search for tasks whose last attempt is the answer: closer to the fastest success, in the last attempt slower than that."""

    STEP_FACTOR, BISECTION_SHARE, MIN_GAIN_FACTOR, RETREAT_FACTOR, FIRST_SPEED_FACTOR, FINAL_RETREAT_FACTOR = (
        1.16,
        0.2,
        1.0,
        1.35,
        2.0,
        1.1,
    )

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        action = super().__call__(observation, info)
        if self.attempts < few_shot.Config.tries or self.fastest_success is None:
            return action
        self.latest = self.fastest_success / self.FINAL_RETREAT_FACTOR
        return compute_scaled_action(self.latest)


def compute_scaled_action(speed_factor: float) -> np.ndarray:
    """Compute the action of few-shot with the usual rates times a speed factor and the usual ramps divided by it."""
    return few_shot.make_action(
        1000 * min(speed_factor, 1.5), 16_000 * speed_factor, 0.15 / speed_factor, 0.15 / speed_factor
    )


COMMON_PLAYERS: dict[str, Callable[[int], Policy]] = {"random": RandomPolicy, "scripted": lambda seed: ScriptedPolicy()}
"""Shipped players of every task: functions that make one from a seed."""
FORMULA: dict[str, Callable[[int], Policy]] = {"formula": lambda seed: ScriptedPolicy()}
"""Shipped player of tasks whose scripted host follows the engineer's formula."""

TASK_PLAYERS: dict[str, dict[str, Callable[[int], Policy]]] = {
    "one-shot": FORMULA,
    "few-shot": FORMULA
    | {
        "usual": lambda seed: FixedSpeedFactorPolicy(1.0),
        "fixed": lambda seed: FixedSpeedFactorPolicy(3.4),
        "search": lambda seed: SpeedFactorSearch(),
    },
    "few-shot-wide": FORMULA
    | {
        "usual": lambda seed: FixedSpeedFactorPolicy(1.0),
        "fixed": lambda seed: FixedSpeedFactorPolicy(2.6),
        "search": lambda seed: FinalTrySpeedFactorSearch(),
    },
    "line": FORMULA,
    "line-3": FORMULA,
}
"""Shipped players of particular tasks, by the name of the card."""
