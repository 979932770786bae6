"""Measured outcomes of few-shot machines at every boldness. Rules play and learn on them without further moves.

    outcomes = measure_outcomes_by_boldness("few-shot-wide", 2000, 64)   tries 64 machines, seeds from 2000 on, at each BOLDNESS
    outcomes.play_rule(RememberingRule, numbers)                         sums of rewards, (machines,), of a policy
    learn_rule(RememberingRule, outcomes, seed)                          finds the rule's numbers by CMA-ES on the outcomes

A boldness b means the usual rates times b and the usual ramps divided by b. Whether an attempt keeps step is measured once. Two
equal attempts therefore always have the same outcome, although it may differ on a machine near its limit.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from registerbench.baselines.parametric_policies import ATTEMPTS, BoldnessRule, compute_bold_actions
from registerbench.baselines.training_envs import CHEAPER_SETTINGS, make_training_envs
from registerbench.benchmark_tasks import CARDS
from stage.envs.few_shot import FewShotTuning

BOLDNESS = np.geomspace(1.3, 8.5, 20)
LANES = 8
POPULATION, GENERATIONS = 16, 60


@dataclass(frozen=True)
class OutcomesByBoldness:
    """Outcomes of a move at each boldness on each machine, arrays of shape (boldness, machines).

    Attributes:
        kept_step: Whether the move kept step.
        encoder_shows_kept: Whether the encoder shows that the move kept step.
        worth: Value of the move if it holds in a proof, else 0.
        distance: Distance of each machine in the unit of the observation, (machines,).
        last_attempt_counts: Whether the last attempt is the answer, not the best one.
        moves: Number of moves that were made.
        damage: Cost of an attempt that loses steps.
    """

    kept_step: np.ndarray
    encoder_shows_kept: np.ndarray
    worth: np.ndarray
    distance: np.ndarray
    last_attempt_counts: bool
    moves: int
    damage: float

    def select_first_machines(self, machines: int) -> OutcomesByBoldness:
        """Return the outcomes of the first `machines` machines only."""
        share = machines / len(self.distance)
        columns = (a[:, :machines] for a in (self.kept_step, self.encoder_shows_kept, self.worth))
        return OutcomesByBoldness(
            *columns, self.distance[:machines], self.last_attempt_counts, round(self.moves * share), self.damage
        )

    def find_nearest_rows(self, logs: np.ndarray) -> np.ndarray:
        """Return the indices of the nearest boldness.

        Args:
            logs: Logarithms of boldness, (n,).
        """
        return np.abs(np.log(BOLDNESS) - np.asarray(logs)[..., None]).argmin(axis=-1)

    def sum_rewards(self, attempts: np.ndarray) -> np.ndarray:
        """Compute the sum of rewards of an episode on each machine.

        Args:
            attempts: Index of the boldness of each attempt, (attempts, machines).

        Returns:
            Sums of rewards, (machines,).
        """
        machine_indices = np.arange(len(self.distance))
        worth = self.worth[attempts, machine_indices]
        return (worth[-1] if self.last_attempt_counts else worth.max(axis=0)) - self.damage * (
            ~self.kept_step[attempts, machine_indices]
        ).sum(axis=0)

    def play_rule(self, rule_class: type[BoldnessRule], numbers: Any) -> np.ndarray:
        """Play an episode on each machine by a rule.

        Args:
            rule_class: Class of the rule.
            numbers: Numbers of the rule.

        Returns:
            Sums of rewards, (machines,).
        """
        n = len(self.distance)
        rule, shown_kept, attempts, machine_indices = rule_class(numbers, (), n), np.zeros(n, bool), [], np.arange(n)
        for rule.attempts_made in range(ATTEMPTS):
            attempts.append(self.find_nearest_rows(rule.choose_log_boldness(self.distance, shown_kept)))
            shown_kept = self.encoder_shows_kept[attempts[-1], machine_indices]
        return self.sum_rewards(np.array(attempts))


def measure_outcomes_by_boldness(task: str, first_seed: int, machines: int) -> OutcomesByBoldness:
    """Make a move of every boldness on each machine.

    Args:
        task: Name of a card.
        first_seed: Seed of the first machine.
        machines: Number of machines, a multiple of LANES.

    Returns:
        The outcomes.
    """
    envs = make_training_envs(task, LANES, **CHEAPER_SETTINGS[task] | {"tries": 1})
    names, outcomes, moves = [e.name for e in envs.observation_features], [], 0
    for begin in range(0, machines, LANES):
        rows = []
        for b in BOLDNESS:
            envs.reset(seed=first_seed + begin)
            observation, *_, info = envs.step(compute_bold_actions(np.full(LANES, b)).astype(np.float32))
            worth = np.maximum(np.log(2 * info["usual"]) - np.log(info["proved"]), 0.0)
            rows.append(
                (info["kept"], observation[:, names.index("kept")] > 0, worth, observation[:, names.index("distance")])
            )
            moves += LANES
            if not info["kept"].any() and b > 4:
                break  # a bolder move loses steps as well
        rows += [copy.deepcopy(rows[-1])] * (len(BOLDNESS) - len(rows))
        outcomes.append(np.array(rows, float).transpose(1, 0, 2))
    envs.close()
    kept_step, shown_kept, worth, distance = np.concatenate(outcomes, axis=2)
    config = FewShotTuning.Config(**CARDS[task].settings)
    return OutcomesByBoldness(
        kept_step > 0, shown_kept > 0, worth, distance[0], config.answer == "last", moves, config.damage_weight
    )


def learn_rule(rule_class: type[BoldnessRule], table: OutcomesByBoldness, seed: int) -> np.ndarray:
    """Search the numbers of a rule by CMA-ES on measured outcomes.

    Args:
        rule_class: Class of the rule.
        table: Outcomes on which the rule plays.
        seed: Seed of CMA-ES.

    Returns:
        Mean of CMA-ES, which `Rule.scale_numbers` converts to the numbers of the rule.
    """
    from cmaes import CMA

    search = CMA(mean=np.zeros(len(rule_class.INITIAL_NUMBERS)), sigma=1.0, seed=seed, population_size=POPULATION)
    for _ in range(GENERATIONS):
        candidates = [search.ask() for _ in range(POPULATION)]
        search.tell([(z, -float(table.play_rule(rule_class, rule_class.scale_numbers(z)).mean())) for z in candidates])
    return search.mean
