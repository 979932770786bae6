"""Players that are shipped with the benchmark, which a new method should beat."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    """Policy with one speed factor for all machines and attempts: the usual speeds times it, the usual ramps divided by it."""

    def __init__(self, speed_factor: float):
        self.speed_factor = speed_factor

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return compute_scaled_action(self.speed_factor)


class FixedMovesPolicy:
    """Policy of few-shot with the same moves on every machine, one for each attempt: it never looks at what they did."""

    def __init__(self, actions: Sequence[np.ndarray]):
        self.actions = actions

    def reset(self, policy_context: PolicyContext) -> None:
        self.attempts = 0

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        self.attempts += 1
        return self.actions[min(self.attempts, len(self.actions)) - 1]


class LastAttemptSearch:
    """Policy of few-shot-wide, where the last attempt is the answer: it searches for the largest speed factor that keeps step.

    It multiplies the speed factor by STEP_FACTOR until an attempt fails, then tries between the fastest success and the slowest
    failure (at BISECTION_SHARE of the way, on a logarithmic scale). The last attempt is FINAL_RETREAT_FACTOR slower than the
    fastest success.
    """

    FIRST_SPEED_FACTOR, STEP_FACTOR, BISECTION_SHARE, RETREAT_FACTOR, FINAL_RETREAT_FACTOR = 2.0, 1.16, 0.2, 1.35, 1.1

    def reset(self, policy_context: PolicyContext) -> None:
        self.kept_indices = [k for k, name in enumerate(policy_context.feature_names) if name == "kept"]
        self.fastest_success: float | None = None
        self.slowest_failure, self.latest, self.attempts = np.inf, self.FIRST_SPEED_FACTOR, 0

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        if self.attempts:
            self._update_bounds(observation[self.kept_indices[min(self.attempts, len(self.kept_indices)) - 1]] > 0)
        self.attempts += 1
        if self.attempts == few_shot.Config.tries and self.fastest_success is not None:
            self.latest = self.fastest_success / self.FINAL_RETREAT_FACTOR
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
        self.latest = self.fastest_success * self.STEP_FACTOR if np.isinf(self.slowest_failure) else between


class LowestCostSearch:
    """Policy of few-shot that searches for the speed factor with the lowest cost that a host can observe.

    The cost is that of the task: the seconds of the move, and the price of the swing that the encoder shows. The first
    LADDER_LENGTH attempts multiply the speed factor by LADDER_FACTOR, until one loses steps. Each further attempt goes between the
    best speed factor so far and a neighbour of it, where the gap is larger.
    """

    FIRST_SPEED_FACTOR, LADDER_FACTOR, LADDER_LENGTH = 1.5, 1.5, 4

    def reset(self, policy_context: PolicyContext) -> None:
        names = policy_context.feature_names
        self.in_step_indices = [k for k, name in enumerate(names) if name == "kept"]
        self.swing_indices = [k for k, name in enumerate(names) if name == "swing"]
        self.costs_by_speed_factor: dict[float, float] = {}
        self.latest, self.attempts = self.FIRST_SPEED_FACTOR, 0

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        if self.attempts:
            self.costs_by_speed_factor[self.latest] = self._compute_cost(observation, info)
            self.latest = self._choose_next_speed_factor()
        self.attempts += 1
        return compute_scaled_action(self.latest)

    def _compute_cost(self, observation: np.ndarray, info: Mapping[str, Any]) -> float:
        """Compute the cost of the last attempt, s; infinite if it lost steps."""
        latest = min(self.attempts, len(self.in_step_indices)) - 1
        if observation[self.in_step_indices[latest]] <= 0:
            return np.inf
        swing = float(observation[self.swing_indices[latest]])
        return info["duration"] + few_shot.Config.vibration_weight * swing / max(1 - swing, 1e-6)

    def _choose_next_speed_factor(self) -> float:
        """Choose the speed factor of the next attempt from the costs of all attempts."""
        tried = sorted(self.costs_by_speed_factor)
        best = min(tried, key=self.costs_by_speed_factor.__getitem__)
        if np.isinf(self.costs_by_speed_factor[best]):
            return tried[0] / self.LADDER_FACTOR
        if len(tried) < self.LADDER_LENGTH and all(np.isfinite(cost) for cost in self.costs_by_speed_factor.values()):
            return self.latest * self.LADDER_FACTOR
        rank = tried.index(best)
        gap_above = (tried[rank + 1] / best) ** 0.5 if best < tried[-1] else self.LADDER_FACTOR
        gap_below = (best / tried[rank - 1]) ** 0.5 if rank else self.LADDER_FACTOR
        return best * gap_above if gap_above >= gap_below else best / gap_below


def compute_scaled_action(speed_factor: float) -> np.ndarray:
    """Compute the action of few-shot with the usual rates times a speed factor and the usual ramps divided by it."""
    return few_shot.make_action(
        1000 * min(speed_factor, 1.5), 16_000 * speed_factor, 0.15 / speed_factor, 0.15 / speed_factor
    )


FIXED_MOVES = (
    *(compute_scaled_action(speed_factor) for speed_factor in (1.5, 2.2, 2.6, 3.0, 3.6)),
    *(few_shot.make_action(1000, rate, ramp, ramp) for rate, ramp in ((30_000, 0.05), (40_000, 0.25), (60_000, 0.3))),
)
"""Actions of the player `fixed` of few-shot, one for each attempt."""

COMMON_PLAYERS: dict[str, Callable[[int], Policy]] = {"random": RandomPolicy, "scripted": lambda seed: ScriptedPolicy()}
"""Shipped players of every task: functions that make one from a seed."""
FORMULA: dict[str, Callable[[int], Policy]] = {"formula": lambda seed: ScriptedPolicy()}
"""Shipped player of tasks whose scripted host follows the engineer's formula."""

TASK_PLAYERS: dict[str, dict[str, Callable[[int], Policy]]] = {
    "one-shot": FORMULA
    | {
        "usual": lambda seed: FixedSpeedFactorPolicy(1.0),
        "fixed": lambda seed: FixedSpeedFactorPolicy(2.6),
    },
    "few-shot": FORMULA
    | {
        "usual": lambda seed: FixedSpeedFactorPolicy(1.0),
        "fixed": lambda seed: FixedMovesPolicy(FIXED_MOVES),
        "search": lambda seed: LowestCostSearch(),
    },
    "few-shot-wide": FORMULA
    | {
        "usual": lambda seed: FixedSpeedFactorPolicy(1.0),
        "fixed": lambda seed: FixedSpeedFactorPolicy(2.6),
        "search": lambda seed: LastAttemptSearch(),
    },
    "line": FORMULA,
    "line-3": FORMULA,
}
"""Shipped players of particular tasks, by the name of the card."""

REFERENCES = {
    "one-shot": "fixed",
    "few-shot": "fixed",
    "few-shot-wide": "search",
    "line": "formula",
    "line-3": "formula",
}
"""Player to which others are compared, by the name of the card; it does not learn. `scripted` for other cards."""
