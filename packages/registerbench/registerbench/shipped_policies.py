"""Players that are shipped with the bench: what a method has to beat."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stage.envs import few_shot

if TYPE_CHECKING:
    from registerbench.policies import Policy, PolicyContext


class Random:
    """Evenly among all actions; among those that an action mask allows, where there is one."""

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


class Scripted:
    """The task's own host that learns nothing."""

    def reset(self, context: PolicyContext) -> None:
        self.env = context.env

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return self.env.scripted_action()


class Bold:
    """Few-shot: usual speeds times a boldness, usual ramps divided by it, the same for every try."""

    def __init__(self, boldness: float):
        self.boldness = boldness

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return action_at(self.boldness)


class Search:
    """Few-shot: bolder by STEP while the encoder shows no loss, then half way (SHARE) back to the boldest that held."""

    STEP, SHARE, CLOSE, RETREAT, FIRST = 1.12, 0.5, 1.1, 1.4, 3.4 / 1.12

    def reset(self, context: PolicyContext) -> None:
        self.kept = [k for k, name in enumerate(context.entries) if name == "kept"]
        self.good: float | None = None
        self.bad, self.last, self.tries = np.inf, self.FIRST, 0

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        if self.tries:
            self._learn(observation[self.kept[min(self.tries, len(self.kept)) - 1]] > 0)
        self.tries += 1
        return action_at(self.last)

    def _learn(self, kept: bool) -> None:
        if kept:
            self.good = max(self.good or 0.0, self.last)
        else:
            self.bad = min(self.bad, self.last)
        if self.good is not None and self.good >= self.bad:
            self.good = None  # it was luck
        if self.good is None:
            self.last = self.bad / self.RETREAT
            return
        between = self.good ** (1 - self.SHARE) * self.bad**self.SHARE
        bolder = self.good * self.STEP if np.isinf(self.bad) else between
        self.last = bolder if bolder > self.good * self.CLOSE else self.good


class Answer(Search):
    """Few-shot where the last try is the answer: closer to what held, and the last BACK times tamer than that."""

    STEP, SHARE, CLOSE, RETREAT, FIRST, BACK = 1.16, 0.2, 1.0, 1.35, 2.0, 1.1

    def __call__(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        action = super().__call__(observation, info)
        if self.tries < few_shot.Config.tries or self.good is None:
            return action
        self.last = self.good / self.BACK
        return action_at(self.last)


def action_at(boldness: float) -> np.ndarray:
    return few_shot.action_of(1000 * min(boldness, 1.5), 16_000 * boldness, 0.15 / boldness, 0.15 / boldness)


PLAYERS: dict[str, Callable[[int], Policy]] = {"random": Random, "scripted": lambda seed: Scripted()}
"""Shipped players of every task; made with a seed."""
FORMULA: dict[str, Callable[[int], Policy]] = {"formula": lambda seed: Scripted()}
"""Where the task's own host is the engineer's formula."""

SHIPPED: dict[str, dict[str, Callable[[int], Policy]]] = {
    "one-shot": FORMULA,
    "few-shot": FORMULA
    | {
        "usual": lambda seed: Bold(1.0),
        "fixed": lambda seed: Bold(3.4),
        "search": lambda seed: Search(),
    },
    "few-shot-wide": FORMULA
    | {"usual": lambda seed: Bold(1.0), "fixed": lambda seed: Bold(2.6), "search": lambda seed: Answer()},
    "line": FORMULA,
    "line-3": FORMULA,
}
"""Those of some tasks."""
