"""Learners from scratch on the tasks with continuous actions: CMA-ES chooses the numbers of a small rule (rules.py).

python -m registerbench.baselines.rule_learners learn one-shot -o runs
python -m registerbench.baselines.rule_learners learn few-shot-wide --seeds 0 1 2 3 4 5 6 7 8 9 -o runs
python -m registerbench.baselines.rule_learners submit runs/few-shot-wide_*.json -o entries --splits train nova

Generations of POPULATION choices, each played on the same machines of train (BUDGET), which are others for each generation and
each run; what CMA-ES then has as its middle is the policy. Nothing is chosen by test episodes. Learning has cheaper settings than
the tests, CHEAPER. At the beginning, where all runs are the same, and after a quarter, half and all of the generations the middle
plays test episodes, which is the run's curve: a CSV with a row for each episode.

few-shot and few-shot-wide are learned on a table (boldness.py): a run tries TABLE machines of train at every boldness, once, and
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

from registerbench.baselines import stops
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.boldness import learned, tabulate
from registerbench.baselines.rules import RULES, Bold, Rule
from registerbench.cards import CARDS, FIRST_TEST_SEED, OPEN_ROUND

BUDGET = {"one-shot": (12, 16), "line": (12, 8), "home": (8, 12)}
"""Generations, and machines of each."""
POPULATION = 8
TABLE, PARTS = 48, (12, 48)
EPISODES = 32  # of a point of the curve
CHEAPER: dict[str, dict[str, Any]] = {
    "one-shot": {"proofs": 1, "settle": 0.03},
    "few-shot": {"settle": 0.03},
    "few-shot-wide": {"settle": 0.03},
    "line": {"proofs": 1, "rest": 0.03},
}
BEGUN: dict[tuple[str, type[Rule]], tuple[np.ndarray, np.ndarray]] = {}
COLUMNS = ("steps", "processor_s", "episode", "return", "success")


def vector(task: str, machines: int, **settings: Any) -> Any:
    import gymnasium

    import stage.envs  # noqa: F401

    card, kind = CARDS[task], {"vectorization_mode": "vector_entry_point", "autoreset_mode": "NextStep", "threads": 1}
    chosen = {"memory": "last"} if "memory" in card.choices else {}
    return gymnasium.make_vec(card.id, machines, **kind, **{**card.settings, **chosen, **settings}).unwrapped


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


class Run:
    """One run of a learner, and its curve."""

    def __init__(self, task: str, player: str, seed: int):
        self.kind, self.task, self.seed = RULES[task, player], task, seed
        self.generations, self.machines = BUDGET.get(task, (0, 1))
        self.learning = vector(task, self.machines, **CHEAPER.get(task, {}))
        self.testing = vector(task, EPISODES)
        self.moves, self.seconds = 0, 0.0
        self.rows: list[tuple] = [COLUMNS]

    def check(self, z: np.ndarray) -> float:
        total, won = (
            self.first() if not z.any() else play(self.testing, self.kind, self.kind.numbers(z), FIRST_TEST_SEED)[:2]
        )
        for k, (value, success) in enumerate(zip(total.tolist(), won.tolist(), strict=True)):
            self.rows.append((self.moves, f"{self.seconds:.1f}", FIRST_TEST_SEED + k, f"{value:.5f}", int(success)))
        return float(total.mean())

    def first(self) -> tuple[np.ndarray, np.ndarray]:
        """Return what the rule reaches before it has learned, the same for all seeds."""
        if (self.task, self.kind) not in BEGUN:
            begins = np.array(self.kind.BEGINS)
            BEGUN[self.task, self.kind] = play(self.testing, self.kind, begins, FIRST_TEST_SEED)[:2]
        return BEGUN[self.task, self.kind]

    def generation(self, search: Any, number: int) -> None:
        begun, machines = time.process_time(), 1000 * (self.seed + 1) + self.machines * number
        asked, worth = [search.ask() for _ in range(POPULATION)], []
        for z in asked:
            total, _, steps = play(self.learning, self.kind, self.kind.numbers(z), machines)
            worth.append(float(total.mean()))
            self.moves += steps
        search.tell([(z, -value) for z, value in zip(asked, worth, strict=True)])
        self.seconds += time.process_time() - begun

    def learn(self, generations: int) -> np.ndarray:
        """Search the numbers of the rule by CMA-ES."""
        from cmaes import CMA

        size = len(self.kind.BEGINS)
        search = CMA(mean=np.zeros(size), sigma=1.0, seed=self.seed, population_size=POPULATION)
        self.check(search.mean)
        for k in range(generations):
            self.generation(search, k)
            if k + 1 in (generations // 4, generations // 2, generations):
                self.check(search.mean)
        return search.mean

    def learn_on(self, table: Any) -> np.ndarray:
        """Search likewise on a table, with more machines at each point."""
        self.check(z := np.zeros(len(self.kind.BEGINS)))
        for machines in (m for m in PARTS if m <= len(table.distance)):
            begun, part = time.process_time(), table.part(machines)
            z = learned(self.kind, part, self.seed)
            self.seconds += time.process_time() - begun
            self.moves = part.moves
            self.check(z)
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


def learn(task: str, run: int, folder: Path, generations: int | None = None, machines: int = TABLE) -> None:
    """Search the numbers of the rule by CMA-ES."""
    players = {player: folder / f"{task}_{player.replace(' ', '-')}-{run}" for t, player in RULES if t == task}
    folder.mkdir(parents=True, exist_ok=True)
    table, spent = None, 0.0
    for player, path in players.items():
        if path.with_suffix(".json").exists():
            continue
        learner = Run(task, player, run)
        if issubclass(learner.kind, Bold):
            if table is None:
                begun = time.process_time()
                table = tabulate(task, 1000 * (run + 1), machines)
                spent = time.process_time() - begun
                print(f"{task} {run}: tried {machines} machines, {spent:.1f} s", flush=True)
            learner.seconds = spent
            learner.write(learner.learn_on(table), path)
        else:
            learner.write(learner.learn(generations or learner.generations), path)
        learner.close()


class Policy:
    """A learner's policy, for registerbench."""

    def __init__(self, kind: type[Rule], w: list[float]):
        self.kind, self.w = kind, w

    def reset(self, context: Any) -> None:
        self.rule = self.kind(self.w, context.feature_names)

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        return self.rule(observation[None])[0]


def submit(path: Path, splits: list[str], folder: Path, round_: str = OPEN_ROUND) -> None:
    said, (task, _, name) = json.loads(path.read_text()), path.stem.partition("_")
    method, _, run = name.rpartition("-")
    player = method.replace("-", " ")
    chosen = {"memory": "last"} if "memory" in CARDS[task].choices else {}
    how = {"settings": chosen, "name": player, "cost": said["cost"], "round_": round_}
    for split in splits:
        write_entry(Policy(RULES[task, player], said["w"]), task, split, folder, method, int(run), **how)


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
    with stops("runs that are done are kept, and the same command goes on after them."):
        args.run(args)


if __name__ == "__main__":
    main()
