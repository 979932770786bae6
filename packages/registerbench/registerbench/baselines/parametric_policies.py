"""Small policies for the tasks of the benchmark, with a few numbers that a learner chooses (parametric_policy_learners.py).

    policy = PARAMETRIC_POLICIES["few-shot-wide", "es with memory"](numbers, feature_names, machines)
    actions = policy(observations)      arrays of shape (machines, ...); one call for each step of an episode

A speed factor multiplies the usual rates of a move and divides its usual ramp times: 2 is a move at twice the usual rates.
All policies observe only what a host can observe. They begin in the middle of the allowed range, or at twice the usual speeds, and
never use the answer of a formula.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from registerbench.shipped_policies import compute_scaled_action

ATTEMPTS = 8
MIN_SPEED_FACTOR, MAX_SPEED_FACTOR = 0.5, 12.0


class ParametricPolicy:
    """Policy with a few numbers that a learner chooses.

    Args:
        numbers: Numbers of the policy.
        names: Names of the features of an observation.
        machines: Number of machines that the policy plays at once.

    Attributes:
        INITIAL_NUMBERS: Numbers before the policy has learned.
        DEVIATIONS: Standard deviation of each number in the first generation.
        attempts_made: Number of steps of the episode so far.
    """

    INITIAL_NUMBERS: ClassVar[tuple[float, ...]]
    DEVIATIONS: ClassVar[tuple[float, ...]]

    def __init__(self, numbers: Sequence[float] | np.ndarray, names: Sequence[str], machines: int = 1):
        self.w, self.names, self.attempts_made = np.asarray(numbers, float), list(names), 0

    @classmethod
    def scale_numbers(cls, cma_numbers: np.ndarray) -> np.ndarray:
        """Convert the numbers of CMA-ES to those of the policy.

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


class LinearPolicy(ParametricPolicy):
    """Parametric policy in which some actions are linear functions of features; the other actions are 0."""

    ACTIONS: ClassVar[tuple[int, int]]
    """Number of actions that the policy computes, and number of all actions."""

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


class OneShotLinearPolicy(LinearPolicy):
    """Parametric policy of one-shot: both rates and both ramps follow from the distance and the declared payload."""

    ACTIONS = 4, 4
    INITIAL_NUMBERS, DEVIATIONS = (0.0,) * 12, (0.5,) * 4 + (0.25,) * 8

    def compute_features(self, observation: np.ndarray) -> list[np.ndarray]:
        return [self.get_feature("distance", observation), self.get_feature("declared", observation)]


class LineLinearPolicy(LinearPolicy):
    """Parametric policy of line: rate and ramp follow from the longest distance and from the ratio of the shortest to it."""

    ACTIONS = 2, 14
    INITIAL_NUMBERS, DEVIATIONS = (0.0,) * 6, (0.5,) * 2 + (0.25,) * 4

    def compute_features(self, observation: np.ndarray) -> list[np.ndarray]:
        distances = np.abs(observation[:, [k for k, name in enumerate(self.names) if name == "distance"]])
        max_distance = distances.max(axis=1)
        return [np.log(max_distance) + 1.0, np.log(distances.min(axis=1) / max_distance) + 1.0]


class HomePolicy(ParametricPolicy):
    """Parametric policy of home: rates, ramps and backing off are constant.

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


def compute_scaled_actions(speed_factor: np.ndarray) -> np.ndarray:
    """Compute actions with the usual rates times a speed factor and the usual ramp times divided by it.

    Args:
        speed_factor: Speed factor of each machine, (n,).

    Returns:
        Actions, (n, 4).
    """
    return np.stack([compute_scaled_action(b) for b in speed_factor.tolist()])


class SpeedFactorPolicy(ParametricPolicy):
    """Parametric policy of few-shot that chooses one speed factor for each attempt."""

    def choose_actions(self, observation: np.ndarray) -> np.ndarray:
        return compute_scaled_actions(
            np.exp(
                self.choose_log_speed_factor(
                    self.get_feature("distance", observation), self.get_feature("kept", observation) > 0
                )
            )
        )

    def choose_log_speed_factor(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        """Choose the logarithm of the next speed factor within the permitted range.

        Args:
            distance: Distance of each machine, (n,).
            in_step: Whether the last attempt kept step by the encoder, (n,).

        Returns:
            Logarithms, (n,).
        """
        return np.clip(
            self.compute_log_speed_factor(distance, in_step), np.log(MIN_SPEED_FACTOR), np.log(MAX_SPEED_FACTOR)
        )

    def compute_log_speed_factor(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        """Compute the logarithm of the next speed factor, before it is limited to the permitted range.

        Args:
            distance: Distance of each machine's move, as the observation has it, (n,).
            in_step: Whether the encoder showed no lost step in the last attempt, (n,).

        Returns:
            Logarithms, (n,).
        """
        raise NotImplementedError


class ScheduledPolicy(SpeedFactorPolicy):
    """Parametric policy w0 + w1 * distance + w2 * share of attempts made, which does not depend on the outcomes of the attempts.

    The speed factor can rise or fall during an episode, so that the last attempt has the speed factor that the policy aims at.
    """

    INITIAL_NUMBERS, DEVIATIONS = (0.7, 0.0, 0.0), (0.4, 0.2, 0.4)

    def compute_log_speed_factor(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        w = self.w
        return w[0] + w[1] * distance + w[2] * self.attempts_made / ATTEMPTS


class RememberingPolicy(SpeedFactorPolicy):
    """Policy that remembers earlier attempts, and tries between the fastest that kept step and the slowest that did not."""

    INITIAL_NUMBERS, DEVIATIONS = (0.7, 0.0, 0.2, 0.5, 0.1), (0.4, 0.2, 0.1, 0.2, 0.1)

    def __init__(self, numbers: Sequence[float] | np.ndarray, names: Sequence[str], machines: int = 1):
        super().__init__(numbers, names, machines)
        self.fastest_success, self.slowest_failure, self.last = (
            np.full(machines, -np.inf),
            np.full(machines, np.inf),
            np.zeros(machines),
        )  # logarithms

    def choose_log_speed_factor(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        self.last = super().choose_log_speed_factor(distance, in_step)
        return self.last

    def update_success_and_failure(self, in_step: np.ndarray) -> None:
        """Update the fastest success and the slowest failure of each machine after an attempt.

        Args:
            in_step: Whether the last attempt kept step by the encoder, (n,).
        """
        self.fastest_success = np.where(in_step, np.maximum(self.fastest_success, self.last), self.fastest_success)
        self.slowest_failure = np.where(in_step, self.slowest_failure, np.minimum(self.slowest_failure, self.last))
        self.fastest_success = np.where(self.fastest_success >= self.slowest_failure, -np.inf, self.fastest_success)

    def compute_log_speed_factor(self, distance: np.ndarray, in_step: np.ndarray) -> np.ndarray:
        (first, slope), (up, share, back) = self.w[:2], np.abs(self.w[2:])
        down = 2 * up
        if not self.attempts_made:
            return first + slope * distance
        self.update_success_and_failure(in_step)
        has_success, has_failure = np.isfinite(self.fastest_success), np.isfinite(self.slowest_failure)
        with np.errstate(invalid="ignore"):
            between = self.fastest_success + min(share, 1.0) * (self.slowest_failure - self.fastest_success)
        if self.attempts_made == ATTEMPTS - 1:
            return np.where(has_success, self.fastest_success - back, self.slowest_failure - down)
        return np.where(
            has_success & has_failure,
            between,
            np.where(has_success, self.fastest_success + up, self.slowest_failure - down),
        )


PARAMETRIC_POLICIES: dict[tuple[str, str], type[ParametricPolicy]] = {
    ("one-shot", "es"): OneShotLinearPolicy,
    ("few-shot", "es without memory"): ScheduledPolicy,
    ("few-shot", "es with memory"): RememberingPolicy,
    ("few-shot-wide", "es without memory"): ScheduledPolicy,
    ("few-shot-wide", "es with memory"): RememberingPolicy,
    ("home", "es"): HomePolicy,
    ("line", "es"): LineLinearPolicy,
}
"""Classes of policies by (name of the card, name of the player)."""
