"""Tables of machines of few-shot that were tried at every boldness. Rules play and learn on a table without further moves.

table = measure_boldness_table("few-shot-wide", 2000, 64)   tries 64 machines, seeds from 2000 on, at each of BOLDNESS
table.play_rule(RememberingRule, w)                         sums of rewards, (machines,), of a rule of rule_policies.py
learn_rule(RememberingRule, table, seed)                    finds the rule's numbers by CMA-ES on the table

A boldness b means the usual rates times b and the usual ramps divided by b. The table measures once whether an attempt keeps
step. Two equal attempts therefore always have the same outcome, although it may differ on a machine near its limit.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from registerbench.baselines.rule_policies import ATTEMPTS, BoldnessRule, compute_bold_actions
from registerbench.baselines.training_envs import CHEAPER_SETTINGS, make_training_envs
from registerbench.benchmark_tasks import CARDS
from stage.envs.few_shot import FewShotTuning

BOLDNESS = np.geomspace(1.3, 8.5, 20)
LANES = 8
POPULATION, GENERATIONS = 16, 60


@dataclass(frozen=True)
class BoldnessTable:
    """Outcomes of each boldness on each machine, (boldness, machines).

    Attributes:
        kept_step: Whether the move kept step.
        shown_kept: Whether the encoder shows that the move kept step.
        worth: Value of the move if it holds, else 0.
        distance: Distance of each machine in the unit of the observation, (machines,).
        last: Whether the last attempt is the answer, not the best one.
        moves: Number of moves that were made.
        damage: Cost of an attempt that loses steps.
    """

    kept_step: np.ndarray
    shown_kept: np.ndarray
    worth: np.ndarray
    distance: np.ndarray
    last: bool
    moves: int
    damage: float

    def select_first_machines(self, machines: int) -> BoldnessTable:
        """Return a table with the first `machines` machines only."""
        share = machines / len(self.distance)
        columns = (a[:, :machines] for a in (self.kept_step, self.shown_kept, self.worth))
        return BoldnessTable(*columns, self.distance[:machines], self.last, round(self.moves * share), self.damage)

    def find_rows(self, logs: np.ndarray) -> np.ndarray:
        """Return the rows with the nearest boldness.

        Args:
            logs: Logarithms of boldness, (n,).
        """
        return np.abs(np.log(BOLDNESS) - np.asarray(logs)[..., None]).argmin(axis=-1)

    def sum_rewards(self, attempts: np.ndarray) -> np.ndarray:
        """Compute the sum of rewards on each machine.

        Args:
            attempts: Rows that were tried, (attempts, machines).

        Returns:
            Sums of rewards, (machines,).
        """
        machine_indices = np.arange(len(self.distance))
        worth = self.worth[attempts, machine_indices]
        return (worth[-1] if self.last else worth.max(axis=0)) - self.damage * (
            ~self.kept_step[attempts, machine_indices]
        ).sum(axis=0)

    def play_rule(self, kind: type[BoldnessRule], w: Any) -> np.ndarray:
        n = len(self.distance)
        rule, shown_kept, attempts, machine_indices = kind(w, (), n), np.zeros(n, bool), [], np.arange(n)
        for rule.attempts_made in range(ATTEMPTS):
            attempts.append(self.find_rows(rule.choose_log_boldness(self.distance, shown_kept)))
            shown_kept = self.shown_kept[attempts[-1], machine_indices]
        return self.sum_rewards(np.array(attempts))


def measure_boldness_table(task: str, first_seed: int, machines: int) -> BoldnessTable:
    """Try a move of every boldness on each machine.

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
    return BoldnessTable(
        kept_step > 0, shown_kept > 0, worth, distance[0], config.answer == "last", moves, config.damage_weight
    )


def learn_rule(rule_class: type[BoldnessRule], table: BoldnessTable, seed: int) -> np.ndarray:
    """Search the numbers of a rule on a table by CMA-ES.

    Args:
        rule_class: Class of the rule.
        table: Outcomes on which the rule is played.
        seed: Seed of CMA-ES.

    Returns:
        The numbers before `Rule.scale_numbers`.
    """
    from cmaes import CMA

    search = CMA(mean=np.zeros(len(rule_class.BEGINS)), sigma=1.0, seed=seed, population_size=POPULATION)
    for _ in range(GENERATIONS):
        candidates = [search.ask() for _ in range(POPULATION)]
        search.tell([(z, -float(table.play_rule(rule_class, rule_class.scale_numbers(z)).mean())) for z in candidates])
    return search.mean
