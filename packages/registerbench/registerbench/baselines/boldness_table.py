"""Machines of few-shot that were tried at every boldness, on which rules are played and learned without further moves.

table = measure_boldness_table("few-shot-wide", 2000, 64)   machines of the seeds from 2000 on, each tried at each of BOLDNESS
table.play(RememberingRule, w)                              sums of rewards, (machines,), of a rule of rule_policies.py
learn_rule(RememberingRule, table, seed)                    its numbers by CMA-ES on the table

A boldness b means the usual rates times b and the usual ramps divided by b. Whether an attempt keeps step is measured once, so
two equal attempts are the same on the table, though they need not be on a machine near its limit.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from registerbench.baselines.rule_policies import ATTEMPTS, BoldnessRule, compute_bold_actions
from registerbench.baselines.training_envs import CHEAPER_SETTINGS, make_training_envs
from registerbench.cards import CARDS
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
        distance: Distance of each machine as an observation has it, (machines,).
        last: Whether the last attempt is the answer.
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

    def take_machines(self, machines: int) -> BoldnessTable:
        """Return the table of the first machines."""
        share = machines / len(self.distance)
        columns = (a[:, :machines] for a in (self.kept_step, self.shown_kept, self.worth))
        return BoldnessTable(*columns, self.distance[:machines], self.last, round(self.moves * share), self.damage)

    def find_rows(self, logs: np.ndarray) -> np.ndarray:
        """Return the rows whose boldness is nearest to these, which are given by their logarithms."""
        return np.abs(np.log(BOLDNESS) - np.asarray(logs)[..., None]).argmin(axis=-1)

    def sum_rewards(self, attempts: np.ndarray) -> np.ndarray:
        """Return the sums of rewards, (machines,), of the rows that were tried, (attempts, machines)."""
        machine_indices = np.arange(len(self.distance))
        worth = self.worth[attempts, machine_indices]
        return (worth[-1] if self.last else worth.max(axis=0)) - self.damage * (
            ~self.kept_step[attempts, machine_indices]
        ).sum(axis=0)

    def play(self, kind: type[BoldnessRule], w: Any) -> np.ndarray:
        n = len(self.distance)
        rule, shown_kept, attempts, machine_indices = kind(w, (), n), np.zeros(n, bool), [], np.arange(n)
        for rule.attempts_made in range(ATTEMPTS):
            attempts.append(self.find_rows(rule.boldness(self.distance, shown_kept)))
            shown_kept = self.shown_kept[attempts[-1], machine_indices]
        return self.sum_rewards(np.array(attempts))


def measure_boldness_table(task: str, first: int, machines: int) -> BoldnessTable:
    """Try moves of every boldness on machines.

    Args:
        task: Name of a card.
        first: Seed of the first machine.
        machines: Number of machines, a multiple of LANES.
    """
    envs = make_training_envs(task, LANES, **CHEAPER_SETTINGS[task] | {"tries": 1})
    names, outcomes, moves = [e.name for e in envs.observation_features], [], 0
    for begin in range(0, machines, LANES):
        rows = []
        for b in BOLDNESS:
            envs.reset(seed=first + begin)
            observation, *_, info = envs.step(compute_bold_actions(np.full(LANES, b)).astype(np.float32))
            worth = np.maximum(np.log(2 * info["usual"]) - np.log(info["proved"]), 0.0)
            rows.append(
                (info["kept"], observation[:, names.index("kept")] > 0, worth, observation[:, names.index("distance")])
            )
            moves += LANES
            if not info["kept"].any() and b > 4:
                break  # what is bolder still is lost, too
        rows += [copy.deepcopy(rows[-1])] * (len(BOLDNESS) - len(rows))
        outcomes.append(np.array(rows, float).transpose(1, 0, 2))
    envs.close()
    kept_step, shown_kept, worth, distance = np.concatenate(outcomes, axis=2)
    config = FewShotTuning.Config(**CARDS[task].settings)
    return BoldnessTable(
        kept_step > 0, shown_kept > 0, worth, distance[0], config.answer == "last", moves, config.damage_weight
    )


def learn_rule(kind: type[BoldnessRule], table: BoldnessTable, seed: int) -> np.ndarray:
    """Search the numbers of a rule on a table by CMA-ES, in the scale of `Rule.numbers`."""
    from cmaes import CMA

    search = CMA(mean=np.zeros(len(kind.BEGINS)), sigma=1.0, seed=seed, population_size=POPULATION)
    for _ in range(GENERATIONS):
        candidates = [search.ask() for _ in range(POPULATION)]
        search.tell([(z, -float(table.play(kind, kind.numbers(z)).mean())) for z in candidates])
    return search.mean
