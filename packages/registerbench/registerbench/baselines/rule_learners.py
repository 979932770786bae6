"""Learners from scratch on the tasks with continuous actions: CMA-ES chooses the numbers of a small rule (rules.py).

python -m registerbench.baselines.rule_learners learn one-shot -o runs
python -m registerbench.baselines.rule_learners learn few-shot-wide --seeds 0 1 2 3 4 5 6 7 8 9 -o runs
python -m registerbench.baselines.rule_learners submit runs/few-shot-wide_*.json -o entries --splits train nova

A generation consists of POPULATION candidates, which play on the same machines of train (BUDGET); each generation of each run has
machines of its own. The mean of CMA-ES's distribution after the last generation is the policy. Nothing is chosen by test episodes.
Training has cheaper settings than the tests (training_envs.py). Before the first generation and after a quarter, half and all of
them the mean plays test episodes, which gives the learning curve: a CSV file with a row for each episode.

few-shot and few-shot-wide are learned on a table (boldness_table.py): a run tries TABLE_MACHINES of train at every boldness, and
CMA-ES chooses the numbers on that, with memory and without by the same tries. Points of the curve are rules that were learned of
the first PARTS machines. A run that is there is not learned again. Needs the package cmaes (extra `rl`).
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from registerbench.baselines import explain_interrupt
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.boldness_table import learn_rule, measure_boldness_table
from registerbench.baselines.rule_policies import RULES, BoldnessRule, Rule
from registerbench.baselines.training_envs import CHEAPER_SETTINGS, make_training_envs
from registerbench.cards import CARDS, FIRST_TEST_SEED, OPEN_ROUND

BUDGET = {"one-shot": (12, 16), "line": (12, 8), "home": (8, 12)}
"""Generations, and machines of each."""
POPULATION = 8
TABLE_MACHINES, TABLE_PARTS = 48, (12, 48)
EPISODES = 32  # of a point of the curve
UNTRAINED_RESULTS: dict[tuple[str, type[Rule]], tuple[np.ndarray, np.ndarray]] = {}
COLUMNS = ("steps", "processor_s", "episode", "return", "success")


def play(envs: Any, kind: type[Rule], w: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Play an episode on each of the machines of seeds seed, seed + 1, ...

    Args:
        envs: Vector environment.
        kind: Class of the rule.
        w: Its numbers.
        seed: Of the first machine.

    Returns:
        Sums of rewards, successes, (n,) each, and the number of steps.
    """
    n = envs.num_envs
    observation, _ = envs.reset(seed=seed)
    rule, steps = kind(w, [e.name for e in envs.observation_features], n), 0
    total, won, over = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
    while not over.all():
        observation, rewards, terminated, truncated, infos = envs.step(rule(observation))
        total += np.where(over, 0.0, rewards)
        steps += int((~over).sum())
        ends = (terminated | truncated) & ~over
        if ends.any():
            won[ends], over = infos["score"]["success"][ends], over | ends
    return total, won, steps


class RuleLearner:
    """One training run of a rule, with its learning curve."""

    def __init__(self, task: str, player: str, seed: int):
        self.kind, self.task, self.seed = RULES[task, player], task, seed
        self.generations, self.machines = BUDGET.get(task, (0, 1))
        self.learning = make_training_envs(task, self.machines, **CHEAPER_SETTINGS.get(task, {}))
        self.testing = make_training_envs(task, EPISODES)
        self.moves, self.seconds = 0, 0.0
        self.rows: list[tuple] = [COLUMNS]

    def add_curve_point(self, z: np.ndarray) -> float:
        total, won = (
            self.play_untrained()
            if not z.any()
            else play(self.testing, self.kind, self.kind.numbers(z), FIRST_TEST_SEED)[:2]
        )
        for k, (value, success) in enumerate(zip(total.tolist(), won.tolist(), strict=True)):
            self.rows.append((self.moves, f"{self.seconds:.1f}", FIRST_TEST_SEED + k, f"{value:.5f}", int(success)))
        return float(total.mean())

    def play_untrained(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the results of the rule before it has learned, which are the same for all seeds."""
        if (self.task, self.kind) not in UNTRAINED_RESULTS:
            begins = np.array(self.kind.BEGINS)
            UNTRAINED_RESULTS[self.task, self.kind] = play(self.testing, self.kind, begins, FIRST_TEST_SEED)[:2]
        return UNTRAINED_RESULTS[self.task, self.kind]

    def generation(self, search: Any, number: int) -> None:
        start_s, machines = time.process_time(), 1000 * (self.seed + 1) + self.machines * number
        candidates, worth = [search.ask() for _ in range(POPULATION)], []
        for z in candidates:
            total, _, steps = play(self.learning, self.kind, self.kind.numbers(z), machines)
            worth.append(float(total.mean()))
            self.moves += steps
        search.tell([(z, -value) for z, value in zip(candidates, worth, strict=True)])
        self.seconds += time.process_time() - start_s

    def learn(self, generations: int) -> np.ndarray:
        """Search the numbers of the rule by CMA-ES."""
        from cmaes import CMA

        size = len(self.kind.BEGINS)
        search = CMA(mean=np.zeros(size), sigma=1.0, seed=self.seed, population_size=POPULATION)
        self.add_curve_point(search.mean)
        for k in range(generations):
            self.generation(search, k)
            if k + 1 in (generations // 4, generations // 2, generations):
                self.add_curve_point(search.mean)
        return search.mean

    def learn_on(self, table: Any) -> np.ndarray:
        """Search the numbers of the rule on a table, with more machines at each point of the curve."""
        self.add_curve_point(z := np.zeros(len(self.kind.BEGINS)))
        for machines in (m for m in TABLE_PARTS if m <= len(table.distance)):
            start_s, part = time.process_time(), table.take_machines(machines)
            z = learn_rule(self.kind, part, self.seed)
            self.seconds += time.process_time() - start_s
            self.moves = part.moves
            self.add_curve_point(z)
        return z

    def write(self, z: np.ndarray, path: Path) -> None:
        cost = {"moves": self.moves, "processor_s": round(self.seconds, 1)}
        w = self.kind.numbers(z).round(4).tolist()
        with path.with_suffix(".csv").open("w", newline="") as file:
            csv.writer(file).writerows(self.rows)
        path.with_suffix(".json").write_text(json.dumps({"w": w, "cost": cost}))
        at = {r[0]: np.mean([float(x[3]) for x in self.rows[1:] if x[0] == r[0]]) for r in self.rows[1:]}
        print(f"{path}: {', '.join(f'{k}: {v:.3f}' for k, v in at.items())}; {w}, {cost['processor_s']} s", flush=True)

    def close(self) -> None:
        self.learning.close()
        self.testing.close()


def learn(task: str, run: int, folder: Path, generations: int | None = None, machines: int = TABLE_MACHINES) -> None:
    """Learn each rule of a task with CMA-ES, and write its numbers and its learning curve, unless they exist."""
    players = {player: folder / f"{task}_{player.replace(' ', '-')}-{run}" for t, player in RULES if t == task}
    folder.mkdir(parents=True, exist_ok=True)
    table, spent = None, 0.0
    for player, path in players.items():
        if path.with_suffix(".json").exists():
            continue
        learner = RuleLearner(task, player, run)
        if issubclass(learner.kind, BoldnessRule):
            if table is None:
                start_s = time.process_time()
                table = measure_boldness_table(task, 1000 * (run + 1), machines)
                spent = time.process_time() - start_s
                print(f"{task} {run}: tried {machines} machines, {spent:.1f} s", flush=True)
            learner.seconds = spent
            learner.write(learner.learn_on(table), path)
        else:
            learner.write(learner.learn(generations or learner.generations), path)
        learner.close()


class RulePolicy:
    """Policy of a rule that was learned, for `registerbench.play`."""

    def __init__(self, kind: type[Rule], w: list[float]):
        self.kind, self.w = kind, w

    def reset(self, context: Any) -> None:
        self.rule = self.kind(self.w, context.feature_names)

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        return self.rule(observation[None])[0]


def submit(path: Path, splits: list[str], folder: Path, round_: str = OPEN_ROUND) -> None:
    stored, (task, _, name) = json.loads(path.read_text()), path.stem.partition("_")
    method, _, run = name.rpartition("-")
    player = method.replace("-", " ")
    settings = {"memory": "last"} if "memory" in CARDS[task].choices else {}
    arguments = {"settings": settings, "name": player, "cost": stored["cost"], "round_": round_}
    for split in splits:
        write_entry(RulePolicy(RULES[task, player], stored["w"]), task, split, folder, method, int(run), **arguments)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    p = commands.add_parser("learn")
    p.add_argument("task", choices=list(dict.fromkeys(task for task, _ in RULES)))
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4], metavar="N", help="a run of each")
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: [learn(a.task, run, a.out) for run in a.seeds])
    p = commands.add_parser("submit")
    p.add_argument("policy", type=Path, nargs="+")
    p.add_argument("--splits", nargs="+", default=["train"])
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.add_argument("--round", default=OPEN_ROUND, metavar="WORD", help="whose test episodes (default: the open ones)")
    p.set_defaults(run=lambda a: [submit(path, a.splits, a.out, a.round) for path in a.policy])
    args = parser.parse_args()
    with explain_interrupt("runs that are done are kept, and the same command goes on after them."):
        args.run(args)


if __name__ == "__main__":
    main()
