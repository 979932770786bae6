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

    def reset(self, context: PolicyContext) -> None:
        if self.space is None:
            self.space = context.action_space
            self.space.seed(self.seed)

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        mask = info.get("action_mask")
        return self.space.sample() if mask is None else self.space.sample(mask=np.asarray(mask, np.int8))


class ScriptedPolicy:
    """Policy of the task's own scripted host, which does not learn."""

    def reset(self, context: PolicyContext) -> None:
        self.env = context.env

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return self.env.scripted_action()


class FixedBoldnessPolicy:
    """Policy of few-shot with one boldness for all attempts: the usual speeds times it, the usual ramps divided by it."""

    def __init__(self, boldness: float):
        self.boldness = boldness

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return compute_bold_action(self.boldness)


class BoldnessSearch:
    """Policy of few-shot that searches for the largest boldness at which the encoder shows no lost step.

    It multiplies the boldness by STEP_FACTOR until an attempt fails, then tries between the boldest success and the tamest
    failure (at BISECTION_SHARE of the way, on a logarithmic scale), until a step gains less than MIN_GAIN_FACTOR.
    """

    STEP_FACTOR, BISECTION_SHARE, MIN_GAIN_FACTOR, RETREAT_FACTOR, FIRST_BOLDNESS = 1.12, 0.5, 1.1, 1.4, 3.4 / 1.12

    def reset(self, context: PolicyContext) -> None:
        self.kept_indices = [k for k, name in enumerate(context.feature_names) if name == "kept"]
        self.boldest_success: float | None = None
        self.tamest_failure, self.latest, self.attempts = np.inf, self.FIRST_BOLDNESS, 0

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        if self.attempts:
            self._update_bounds(observation[self.kept_indices[min(self.attempts, len(self.kept_indices)) - 1]] > 0)
        self.attempts += 1
        return compute_bold_action(self.latest)

    def _update_bounds(self, kept_step: bool) -> None:
        if kept_step:
            self.boldest_success = max(self.boldest_success or 0.0, self.latest)
        else:
            self.tamest_failure = min(self.tamest_failure, self.latest)
        if self.boldest_success is not None and self.boldest_success >= self.tamest_failure:
            self.boldest_success = None  # the same boldness also failed, so its success was luck
        if self.boldest_success is None:
            self.latest = self.tamest_failure / self.RETREAT_FACTOR
            return
        between = self.boldest_success ** (1 - self.BISECTION_SHARE) * self.tamest_failure**self.BISECTION_SHARE
        bolder = self.boldest_success * self.STEP_FACTOR if np.isinf(self.tamest_failure) else between
        self.latest = bolder if bolder > self.boldest_success * self.MIN_GAIN_FACTOR else self.boldest_success


class FinalTryBoldnessSearch(BoldnessSearch):
    """Search for tasks whose last attempt is the answer: closer to the boldest success, and in the last attempt tamer than that."""

    STEP_FACTOR, BISECTION_SHARE, MIN_GAIN_FACTOR, RETREAT_FACTOR, FIRST_BOLDNESS, FINAL_RETREAT_FACTOR = (
        1.16,
        0.2,
        1.0,
        1.35,
        2.0,
        1.1,
    )

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        action = super().__call__(observation, info)
        if self.attempts < few_shot.Config.tries or self.boldest_success is None:
            return action
        self.latest = self.boldest_success / self.FINAL_RETREAT_FACTOR
        return compute_bold_action(self.latest)


def compute_bold_action(boldness: float) -> np.ndarray:
    """Compute the action of few-shot with the usual rates times a boldness and the usual ramps divided by it."""
    return few_shot.action_of(1000 * min(boldness, 1.5), 16_000 * boldness, 0.15 / boldness, 0.15 / boldness)


COMMON_PLAYERS: dict[str, Callable[[int], Policy]] = {"random": RandomPolicy, "scripted": lambda seed: ScriptedPolicy()}
"""Shipped players of every task: functions that make one from a seed."""
FORMULA: dict[str, Callable[[int], Policy]] = {"formula": lambda seed: ScriptedPolicy()}
"""Shipped player of tasks whose scripted host follows the engineer's formula."""

TASK_PLAYERS: dict[str, dict[str, Callable[[int], Policy]]] = {
    "one-shot": FORMULA,
    "few-shot": FORMULA
    | {
        "usual": lambda seed: FixedBoldnessPolicy(1.0),
        "fixed": lambda seed: FixedBoldnessPolicy(3.4),
        "search": lambda seed: BoldnessSearch(),
    },
    "few-shot-wide": FORMULA
    | {
        "usual": lambda seed: FixedBoldnessPolicy(1.0),
        "fixed": lambda seed: FixedBoldnessPolicy(2.6),
        "search": lambda seed: FinalTryBoldnessSearch(),
    },
    "line": FORMULA,
    "line-3": FORMULA,
}
"""Shipped players of particular tasks, by the name of the card."""
