"""Small policies for the tasks of the benchmark, with a few numbers that a learner chooses (parametric_policy_learners.py).

rule = RULES["few-shot-wide", "es with memory"](w, names, n)   w: numbers of the rule; names: features; n: number of machines
actions = rule(observations)                                   (n, ...) each; one call for each step of an episode

All rules observe only what a host can observe. They begin in the middle of the allowed range, or at twice the usual speeds, and
never use the answer of a formula.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from registerbench.shipped_policies import compute_bold_action

ATTEMPTS = 8
TAMEST, BOLDEST = 0.5, 12.0


class Rule:
    """Policy with a few numbers that a learner chooses.

    Args:
        numbers: Numbers of the rule.
        names: Names of the features of an observation.
        machines: Number of machines that the rule plays at once.

    Attributes:
        INITIAL_NUMBERS: Numbers before the rule has learned.
        DEVIATIONS: Standard deviation of each number in the first generation.
        attempts_made: Number of steps of the episode so far.
    """

    INITIAL_NUMBERS: ClassVar[tuple[float, ...]]
    DEVIATIONS: ClassVar[tuple[float, ...]]

    def __init__(self, numbers: Sequence[float] | np.ndarray, names: Sequence[str], machines: int = 1):
        self.w, self.names, self.attempts_made = np.asarray(numbers, float), list(names), 0

    @classmethod
    def scale_numbers(cls, cma_numbers: np.ndarray) -> np.ndarray:
        """Convert the numbers of CMA-ES to those of the rule.

        Args:
            cma_numbers: Numbers with a standard deviation of 1 in the first generation; 0 stands for INITIAL_NUMBERS.
        """
        return np.array(cls.INITIAL_NUMBERS) + np.array(cls.DEVIATIONS) * cma_numbers

    def get_feature(self, name: str, observation: np.ndarray) -> np.ndarray:
        """Return a feature of all machines by name, (machines,)."""
        return observation[:, self.names.index(name)].astype(float)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        action = self.choose_actions(observation)
        self.attempts_made += 1
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def choose_actions(self, observation: np.ndarray) -> np.ndarray:
        """Choose the next actions, (machines, ...), from observations, (machines, features)."""
        raise NotImplementedError


class LinearRule(Rule):
    """Rule in which some actions are linear functions of features; the other actions are 0."""

    FEATURES: ClassVar[int]
    ACTIONS: ClassVar[tuple[int, int]]
    """Number of actions that the rule computes, and number of all actions."""

    def compute_features(self, observation: np.ndarray) -> list[np.ndarray]:
        """Compute the features of which the actions are linear functions, (machines,) each."""
        raise NotImplementedError

    def choose_actions(self, observation: np.ndarray) -> np.ndarray:
        used, every = self.ACTIONS
        out = np.zeros((len(observation), every))
        out[:, :used] = np.stack(
            [np.ones(len(observation)), *self.compute_features(observation)], axis=1
        ) @ self.w.reshape(-1, used)
        return out


class OneShotRule(LinearRule):
    """Rule of one-shot: both rates and both ramps follow from the distance and the declared payload."""

    ACTIONS = 4, 4
    INITIAL_NUMBERS, DEVIATIONS = (0.0,) * 12, (0.5,) * 4 + (0.25,) * 8

    def compute_features(self, observation: np.ndarray) -> list[np.ndarray]:
        return [self.get_feature("distance", observation), self.get_feature("declared", observation)]


class LineRule(LinearRule):
    """Rule of line: rate and ramp follow from the longest distance and from the ratio of the shortest to it."""

    ACTIONS = 2, 14
    INITIAL_NUMBERS, DEVIATIONS = (0.0,) * 6, (0.5,) * 2 + (0.25,) * 4

    def compute_features(self, observation: np.ndarray) -> list[np.ndarray]:
        distances = np.abs(observation[:, [k for k, name in enumerate(self.names) if name == "distance"]])
        max_distance = distances.max(axis=1)
        return [np.log(max_distance) + 1.0, np.log(distances.min(axis=1) / max_distance) + 1.0]


class HomeRule(Rule):
    """Rule of home: rates, ramps and backing off are constant.

    The distance by which ORG is left depends on whether ORG is on. The approach and the report of a fault depend on the
    number of failed returns in a row, and on how the last one failed.
    """

    INITIAL_NUMBERS, DEVIATIONS = (0.0,) * 7 + (-0.5, 0.0, 0.0, 0.0), (0.5,) * 7 + (0.3, 1.0, 0.5, 0.5)

    def choose_actions(self, observation: np.ndarray) -> np.ndarray:
        search, ramp, approach, back_off, leave, asserted, slower, report, *signs = self.w
        failed, ones = self.get_feature("failed", observation), np.ones(len(observation))
        signals = failed, self.get_feature("last_end_limit", observation), self.get_feature("last_late", observation)
        return np.stack(
            [
                search * ones, ramp * ones, approach + slower * failed, leave + asserted * self.get_feature("org", observation),
                back_off * ones, report + sum(w * x for w, x in zip(signs, signals, strict=True)),
            ], axis=1,
        )  # fmt: skip


def compute_bold_actions(boldness: np.ndarray) -> np.ndarray:
    """Compute actions with the usual rates times a boldness and the usual ramps divided by it.

    Args:
        boldness: Boldness of each machine, (n,).

    Returns:
        Actions, (n, 4).
    """
    return np.stack([compute_bold_action(b) for b in boldness.tolist()])


class BoldnessRule(Rule):
    """Rule of few-shot that chooses one boldness for each attempt."""

    def choose_actions(self, observation: np.ndarray) -> np.ndarray:
        return compute_bold_actions(
            np.exp(
                self.choose_log_boldness(
                    self.get_feature("distance", observation), self.get_feature("kept", observation) > 0
                )
            )
        )

    def choose_log_boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        """Choose the logarithm of the next boldness within the permitted range.

        Args:
            distance: Distance of each machine, (n,).
            in_step: Whether the last attempt kept step by the encoder, (n,).

        Returns:
            Logarithms, (n,).
        """
        return np.clip(self.compute_log_boldness(distance, in_step), np.log(TAMEST), np.log(BOLDEST))

    def compute_log_boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        """Compute the logarithm of the next boldness, (n,), before it is limited to the permitted range."""
        raise NotImplementedError


class ScheduledRule(BoldnessRule):
    """Rule w0 + w1 * distance + w2 * share of attempts made, which does not depend on the outcomes of the attempts.

    The boldness can rise or fall during an episode, so that the last attempt has the boldness that the rule aims at.
    """

    INITIAL_NUMBERS, DEVIATIONS = (0.7, 0.0, 0.0), (0.4, 0.2, 0.4)

    def compute_log_boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        w = self.w
        return w[0] + w[1] * distance + w[2] * self.attempts_made / ATTEMPTS


class RememberingRule(BoldnessRule):
    """Rule that remembers earlier attempts, and tries between the boldest that kept step and the tamest that did not."""

    INITIAL_NUMBERS, DEVIATIONS = (0.7, 0.0, 0.2, 0.5, 0.1), (0.4, 0.2, 0.1, 0.2, 0.1)

    def __init__(self, numbers: Sequence[float] | np.ndarray, names: Sequence[str], machines: int = 1):
        super().__init__(numbers, names, machines)
        self.boldest_success, self.tamest_failure, self.last = (
            np.full(machines, -np.inf),
            np.full(machines, np.inf),
            np.zeros(machines),
        )  # logarithms

    def choose_log_boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        self.last = super().choose_log_boldness(distance, in_step)
        return self.last

    def update_bounds(self, in_step: np.ndarray) -> None:
        """Update the boldest success and the tamest failure of each machine after an attempt.

        Args:
            in_step: Whether the last attempt kept step by the encoder, (n,).
        """
        self.boldest_success = np.where(in_step, np.maximum(self.boldest_success, self.last), self.boldest_success)
        self.tamest_failure = np.where(in_step, self.tamest_failure, np.minimum(self.tamest_failure, self.last))
        self.boldest_success = np.where(self.boldest_success >= self.tamest_failure, -np.inf, self.boldest_success)

    def compute_log_boldness(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        (first, slope), (up, share, back) = self.w[:2], np.abs(self.w[2:])
        down = 2 * up
        if not self.attempts_made:
            return first + slope * distance
        self.update_bounds(in_step)
        has_success, has_failure = np.isfinite(self.boldest_success), np.isfinite(self.tamest_failure)
        with np.errstate(invalid="ignore"):
            between = self.boldest_success + min(share, 1.0) * (self.tamest_failure - self.boldest_success)
        if self.attempts_made == ATTEMPTS - 1:
            return np.where(has_success, self.boldest_success - back, self.tamest_failure - down)
        return np.where(
            has_success & has_failure,
            between,
            np.where(has_success, self.boldest_success + up, self.tamest_failure - down),
        )


RULES: dict[tuple[str, str], type[Rule]] = {
    ("one-shot", "es"): OneShotRule,
    ("few-shot", "es without memory"): ScheduledRule,
    ("few-shot", "es with memory"): RememberingRule,
    ("few-shot-wide", "es without memory"): ScheduledRule,
    ("few-shot-wide", "es with memory"): RememberingRule,
    ("home", "es"): HomeRule,
    ("line", "es"): LineRule,
}
"""Classes of rules by (name of the card, name of the player)."""
