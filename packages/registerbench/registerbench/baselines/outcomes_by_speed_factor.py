"""Measured outcomes of few-shot machines at every speed_factor. Policies play and learn on them without further moves.

    outcomes = measure_outcomes_by_speed_factor("few-shot-wide", 2000, 64)   tries 64 machines, seeds from 2000 on
    outcomes.play_policy(RememberingPolicy, numbers)                         returns sums of rewards, (machines,)
    learn_policy_numbers(RememberingPolicy, outcomes, seed)                  finds the policy's numbers by CMA-ES on the outcomes

A speed factor b means the usual rates times b and the usual ramps divided by b. Whether an attempt keeps step is measured once. Two
equal attempts therefore always have the same outcome, although it may differ on a machine near its limit.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from registerbench.baselines.parametric_policies import ATTEMPTS, SpeedFactorPolicy, compute_scaled_actions
from registerbench.baselines.training_envs import CHEAPER_SETTINGS, make_training_envs
from registerbench.benchmark_tasks import CARDS
from stage.envs.few_shot import FewShotTuning

SPEED_FACTORS = np.geomspace(1.3, 8.5, 20)
PARALLEL_ENVS = 8
POPULATION, GENERATIONS = 16, 60


@dataclass(frozen=True)
class OutcomesBySpeedFactor:
    """Outcomes of a move at each speed factor on each machine, arrays of shape (speed factor, machines).

    Attributes:
        in_step: Whether the move kept step.
        encoder_shows_in_step: Whether the encoder shows that the move kept step.
        worth: Value of the move if it holds in a proof, else 0.
        distance: Distance of each machine in the unit of the observation, (machines,).
        last_attempt_counts: Whether the last attempt is the answer, not the best one.
        moves: Number of moves that were made.
        damage: Cost of an attempt that loses steps.
    """

    in_step: np.ndarray
    encoder_shows_in_step: np.ndarray
    worth: np.ndarray
    distance: np.ndarray
    last_attempt_counts: bool
    moves: int
    damage: float

    def select_first_machines(self, machines: int) -> OutcomesBySpeedFactor:
        """Return the outcomes of the first `machines` machines only."""
        share = machines / len(self.distance)
        columns = (a[:, :machines] for a in (self.in_step, self.encoder_shows_in_step, self.worth))
        return OutcomesBySpeedFactor(
            *columns, self.distance[:machines], self.last_attempt_counts, round(self.moves * share), self.damage
        )

    def find_nearest_rows(self, logs: np.ndarray) -> np.ndarray:
        """Return the index of the speed factor in SPEED_FACTORS that is nearest to each given one.

        Args:
            logs: Logarithms of speed factors, (n,).
        """
        return np.abs(np.log(SPEED_FACTORS) - np.asarray(logs)[..., None]).argmin(axis=-1)

    def sum_rewards(self, attempts: np.ndarray) -> np.ndarray:
        """Compute the sum of rewards of an episode on each machine.

        Args:
            attempts: Index of the speed factor of each attempt, (attempts, machines).

        Returns:
            Sums of rewards, (machines,).
        """
        machine_indices = np.arange(len(self.distance))
        worth = self.worth[attempts, machine_indices]
        return (worth[-1] if self.last_attempt_counts else worth.max(axis=0)) - self.damage * (
            ~self.in_step[attempts, machine_indices]
        ).sum(axis=0)

    def play_policy(self, policy_class: type[SpeedFactorPolicy], numbers: Any) -> np.ndarray:
        """Play an episode on each machine by a policy.

        Args:
            policy_class: Class of the policy.
            numbers: Numbers of the policy.

        Returns:
            Sums of rewards, (machines,).
        """
        n = len(self.distance)
        policy, shown_in_step, attempts, machine_indices = (
            policy_class(numbers, (), n),
            np.zeros(n, bool),
            [],
            np.arange(n),
        )
        for policy.attempts_made in range(ATTEMPTS):
            attempts.append(self.find_nearest_rows(policy.choose_log_speed_factor(self.distance, shown_in_step)))
            shown_in_step = self.encoder_shows_in_step[attempts[-1], machine_indices]
        return self.sum_rewards(np.array(attempts))


def measure_outcomes_by_speed_factor(task: str, first_seed: int, machines: int) -> OutcomesBySpeedFactor:
    """Make a move of every speed factor on each machine.

    Args:
        task: Name of a card.
        first_seed: Seed of the first machine.
        machines: Number of machines, a multiple of PARALLEL_ENVS.

    Returns:
        The outcomes.
    """
    envs = make_training_envs(task, PARALLEL_ENVS, **CHEAPER_SETTINGS[task] | {"tries": 1})
    names, outcomes, moves = [e.name for e in envs.observation_features], [], 0
    for begin in range(0, machines, PARALLEL_ENVS):
        rows = []
        for b in SPEED_FACTORS:
            envs.reset(seed=first_seed + begin)
            observation, *_, info = envs.step(compute_scaled_actions(np.full(PARALLEL_ENVS, b)).astype(np.float32))
            worth = np.maximum(np.log(2 * info["usual"]) - np.log(info["proved"]), 0.0)
            rows.append(
                (info["kept"], observation[:, names.index("kept")] > 0, worth, observation[:, names.index("distance")])
            )
            moves += PARALLEL_ENVS
            if not info["kept"].any() and b > 4:
                break  # a faster move loses steps as well
        rows += [copy.deepcopy(rows[-1])] * (len(SPEED_FACTORS) - len(rows))
        outcomes.append(np.array(rows, float).transpose(1, 0, 2))
    envs.close()
    in_step, shown_in_step, worth, distance = np.concatenate(outcomes, axis=2)
    config = FewShotTuning.Config(**CARDS[task].settings)
    return OutcomesBySpeedFactor(
        in_step > 0, shown_in_step > 0, worth, distance[0], config.answer == "last", moves, config.damage_weight
    )


def learn_policy_numbers(policy_class: type[SpeedFactorPolicy], table: OutcomesBySpeedFactor, seed: int) -> np.ndarray:
    """Search the numbers of a policy by CMA-ES on measured outcomes.

    Args:
        policy_class: Class of the policy.
        table: Outcomes on which the policy plays.
        seed: Seed of CMA-ES.

    Returns:
        Mean of CMA-ES, which `ParametricPolicy.scale_numbers` converts to the numbers of the policy.
    """
    from cmaes import CMA

    search = CMA(mean=np.zeros(len(policy_class.INITIAL_NUMBERS)), sigma=1.0, seed=seed, population_size=POPULATION)
    for _ in range(GENERATIONS):
        candidates = [search.ask() for _ in range(POPULATION)]
        search.tell(
            [(z, -float(table.play_policy(policy_class, policy_class.scale_numbers(z)).mean())) for z in candidates]
        )
    return search.mean
