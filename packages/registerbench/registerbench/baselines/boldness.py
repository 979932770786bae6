"""Machines of FewShotTuning that were tried at every boldness: on such a table a rule is played, and learned, without a move.

table = tabulate("few-shot-wide", 2000, 64)   machines of the seeds from 2000 on, each tried at each of BOLDNESS
table.play(Remembering, w)                    sums of rewards, (machines,), of a rule of rules.py
learned(Remembering, table, seed)             by CMA-ES on the table

A boldness is the usual rates times b, the usual ramps divided by b. Whether a try keeps step is drawn once for each, so on the
table two equal tries are the same, which they need not be on a machine near its edge.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from registerbench.baselines.rules import TRIES, Bold, bold
from registerbench.cards import CARDS
from stage.envs.few_shot import FewShotTuning

BOLDNESS = np.geomspace(1.3, 8.5, 20)
LANES = 8
POPULATION, GENERATIONS = 16, 60


@dataclass(frozen=True)
class Table:
    """Outcomes of each boldness on each machine, (boldness, machines).

    Attributes:
        kept: The move kept step.
        shown: Likewise by the encoder.
        worth: Value if it holds; 0 if not.
        distance: As an observation has it, (machines,).
        last: The last try is the answer.
        moves: Moves that were made.
        damage: Cost of a try that loses steps.
    """

    kept: np.ndarray
    shown: np.ndarray
    worth: np.ndarray
    distance: np.ndarray
    last: bool
    moves: int
    damage: float

    def part(self, machines: int) -> Table:
        """Return the table of the first machines."""
        share = machines / len(self.distance)
        columns = (a[:, :machines] for a in (self.kept, self.shown, self.worth))
        return Table(*columns, self.distance[:machines], self.last, round(self.moves * share), self.damage)

    def at(self, logs: np.ndarray) -> np.ndarray:
        """Return the rows of these boldnesses, by their logarithms."""
        return np.abs(np.log(BOLDNESS) - np.asarray(logs)[..., None]).argmin(axis=-1)

    def total(self, tries: np.ndarray) -> np.ndarray:
        """Return the sums of rewards of rows that were tried, (tries, machines)."""
        every = np.arange(len(self.distance))
        worth = self.worth[tries, every]
        return (worth[-1] if self.last else worth.max(axis=0)) - self.damage * (~self.kept[tries, every]).sum(axis=0)

    def play(self, kind: type[Bold], w: Any) -> np.ndarray:
        n = len(self.distance)
        rule, shown, tries, every = kind(w, (), n), np.zeros(n, bool), [], np.arange(n)
        for rule.made in range(TRIES):
            tries.append(self.at(rule.boldness(self.distance, shown)))
            shown = self.shown[tries[-1], every]
        return self.total(np.array(tries))


def tabulate(task: str, first: int, machines: int) -> Table:
    """Play moves of every boldness on machines.

    Args:
        task: Name of a card.
        first: Seed of the first machine.
        machines: A multiple of LANES.
    """
    from registerbench.baselines.rule_learners import CHEAPER, vector

    envs = vector(task, LANES, **CHEAPER[task] | {"tries": 1})
    names, found, moves = [e.name for e in envs.observation_features], [], 0
    for begin in range(0, machines, LANES):
        rows = []
        for b in BOLDNESS:
            envs.reset(seed=first + begin)
            observation, *_, info = envs.step(bold(np.full(LANES, b)).astype(np.float32))
            worth = np.maximum(np.log(2 * info["usual"]) - np.log(info["proved"]), 0.0)
            rows.append(
                (info["kept"], observation[:, names.index("kept")] > 0, worth, observation[:, names.index("distance")])
            )
            moves += LANES
            if not info["kept"].any() and b > 4:
                break  # what is bolder still is lost, too
        rows += [copy.deepcopy(rows[-1])] * (len(BOLDNESS) - len(rows))
        found.append(np.array(rows, float).transpose(1, 0, 2))
    envs.close()
    kept, shown, worth, distance = np.concatenate(found, axis=2)
    config = FewShotTuning.Config(**CARDS[task].settings)
    return Table(kept > 0, shown > 0, worth, distance[0], config.answer == "last", moves, config.damage_weight)


def learned(kind: type[Bold], table: Table, seed: int) -> np.ndarray:
    """Search the numbers of a rule on a table, as `Rule.numbers` takes them."""
    from cmaes import CMA

    search = CMA(mean=np.zeros(len(kind.BEGINS)), sigma=1.0, seed=seed, population_size=POPULATION)
    for _ in range(GENERATIONS):
        asked = [search.ask() for _ in range(POPULATION)]
        search.tell([(z, -float(table.play(kind, kind.numbers(z)).mean())) for z in asked])
    return search.mean
