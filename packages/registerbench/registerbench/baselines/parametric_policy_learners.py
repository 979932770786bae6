"""Learners from scratch on the tasks with continuous actions: CMA-ES chooses the numbers of parametric policies.

python -m registerbench.baselines.parametric_policy_learners learn one-shot -o runs
python -m registerbench.baselines.parametric_policy_learners learn few-shot-wide --seeds 0 1 2 3 4 5 6 7 8 9 -o runs
python -m registerbench.baselines.parametric_policy_learners submit runs/few-shot-wide_*.json -o entries --splits train nova

A generation consists of POPULATION candidates, which play on the same machines of the split train
(GENERATIONS_AND_MACHINES); each generation of each
run has other machines. The policy is the mean of CMA-ES's distribution after the last generation. Nothing is chosen by test
episodes. Training has cheaper settings than the tests (training_envs.py). The mean plays test episodes before the first generation
and after a quarter, half and all of the generations. They form the learning curve: a CSV file with a row for each episode.

The policies of few-shot and few-shot-wide learn on a table (outcomes_by_speed_factor.py): a run tries TABLE_MACHINES machines of
train at every speed factor, and CMA-ES chooses the numbers of both policies, with and without memory, on this table. A point of
the curve is the policy that was learned from the first TABLE_PARTS machines. A finished run is skipped. Needs the package cmaes
(extra `rl`).
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from registerbench.baselines import exit_on_interrupt
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.outcomes_by_speed_factor import learn_policy_numbers, measure_outcomes_by_speed_factor
from registerbench.baselines.parametric_policies import PARAMETRIC_POLICIES, ParametricPolicy, SpeedFactorPolicy
from registerbench.baselines.training_commands import add_enter_command, format_training_command, write_new_entry
from registerbench.baselines.training_envs import CHEAPER_SETTINGS, make_training_envs
from registerbench.benchmark_tasks import CARDS, FIRST_TEST_SEED, OPEN_ROUND

GENERATIONS_AND_MACHINES = {"one-shot": (12, 16), "line": (12, 8), "home": (8, 12)}
"""Number of generations, and number of machines in each, by task."""
POPULATION = 8
TABLE_MACHINES, TABLE_PARTS = 48, (12, 48)
EPISODES = 32  # test episodes of a point of the learning curve
UNTRAINED_RESULTS: dict[tuple[str, type[ParametricPolicy]], tuple[np.ndarray, np.ndarray]] = {}
COLUMNS = ("steps", "processor_s", "episode", "return", "success")


def play_policy(
    envs: Any, policy_class: type[ParametricPolicy], numbers: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """Play one episode on each machine. The machines have the seeds `seed`, `seed + 1`, and so on.

    Args:
        envs: Vector environment.
        policy_class: Class of the policy.
        numbers: Numbers of the policy.
        seed: Seed of the first machine.

    Returns:
        Sums of rewards, (n,), successes, (n,), and the number of all steps.
    """
    n = envs.num_envs
    observation, _ = envs.reset(seed=seed)
    policy, steps = policy_class(numbers, [e.name for e in envs.observation_features], n), 0
    total, won, over = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
    while not over.all():
        observation, rewards, terminated, truncated, infos = envs.step(policy(observation))
        total += np.where(over, 0.0, rewards)
        steps += int((~over).sum())
        ends = (terminated | truncated) & ~over
        if ends.any():
            won[ends], over = infos["score"]["success"][ends], over | ends
    return total, won, steps


class ParametricPolicyLearner:
    """Training run of a policy, with its learning curve.

    Args:
        task: Name of a card.
        player: Name of the player, see PARAMETRIC_POLICIES.
        seed: Seed of the run.
    """

    def __init__(self, task: str, player: str, seed: int):
        self.policy_class, self.task, self.seed = PARAMETRIC_POLICIES[task, player], task, seed
        self.generations, self.machines = GENERATIONS_AND_MACHINES.get(task, (0, 1))
        self.learning = make_training_envs(task, self.machines, **CHEAPER_SETTINGS.get(task, {}))
        self.testing = make_training_envs(task, EPISODES)
        self.moves, self.seconds = 0, 0.0
        self.rows: list[tuple] = [COLUMNS]

    def add_curve_point(self, cma_numbers: np.ndarray) -> float:
        """Play the test episodes with some numbers, add them to the learning curve, and return the mean of their returns.

        Args:
            cma_numbers: Numbers of CMA-ES, which `ParametricPolicy.scale_numbers` converts.
        """
        if cma_numbers.any():
            numbers = self.policy_class.scale_numbers(cma_numbers)
            total, won, _ = play_policy(self.testing, self.policy_class, numbers, FIRST_TEST_SEED)
        else:
            total, won = self.play_untrained()
        for k, (value, success) in enumerate(zip(total.tolist(), won.tolist(), strict=True)):
            self.rows.append((self.moves, f"{self.seconds:.1f}", FIRST_TEST_SEED + k, f"{value:.5f}", int(success)))
        return float(total.mean())

    def play_untrained(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the results of the policy before it has learned, which are the same for all seeds."""
        if (self.task, self.policy_class) not in UNTRAINED_RESULTS:
            begins = np.array(self.policy_class.INITIAL_NUMBERS)
            UNTRAINED_RESULTS[self.task, self.policy_class] = play_policy(
                self.testing, self.policy_class, begins, FIRST_TEST_SEED
            )[:2]
        return UNTRAINED_RESULTS[self.task, self.policy_class]

    def run_generation(self, search: Any, number: int) -> None:
        """Play the candidates of a generation, and update CMA-ES.

        Args:
            search: CMA-ES.
            number: Number of the generation.
        """
        start_s, machines = time.process_time(), 1000 * (self.seed + 1) + self.machines * number
        candidates, worth = [search.ask() for _ in range(POPULATION)], []
        for z in candidates:
            total, _, steps = play_policy(
                self.learning, self.policy_class, self.policy_class.scale_numbers(z), machines
            )
            worth.append(float(total.mean()))
            self.moves += steps
        search.tell([(z, -value) for z, value in zip(candidates, worth, strict=True)])
        self.seconds += time.process_time() - start_s

    def learn_numbers(self, generations: int) -> np.ndarray:
        """Search the numbers of the policy by CMA-ES in the environments, and return the mean of CMA-ES."""
        from cmaes import CMA

        size = len(self.policy_class.INITIAL_NUMBERS)
        search = CMA(mean=np.zeros(size), sigma=1.0, seed=self.seed, population_size=POPULATION)
        self.add_curve_point(search.mean)
        for k in range(generations):
            self.run_generation(search, k)
            if k + 1 in (generations // 4, generations // 2, generations):
                self.add_curve_point(search.mean)
        return search.mean

    def learn_numbers_on_table(self, table: Any) -> np.ndarray:
        """Search the numbers of the policy on measured outcomes of ever more machines, and return the last ones."""
        self.add_curve_point(z := np.zeros(len(self.policy_class.INITIAL_NUMBERS)))
        for machines in (m for m in TABLE_PARTS if m <= len(table.distance)):
            start_s, part = time.process_time(), table.select_first_machines(machines)
            z = learn_policy_numbers(self.policy_class, part, self.seed)
            self.seconds += time.process_time() - start_s
            self.moves = part.moves
            self.add_curve_point(z)
        return z

    def write_policy(self, cma_numbers: np.ndarray, path: Path, length: dict[str, int]) -> None:
        """Write the policy (JSON) and its learning curve (CSV), and print the points of the curve.

        Args:
            cma_numbers: Numbers of CMA-ES, which `ParametricPolicy.scale_numbers` converts.
            path: File without its suffix.
            length: What determines how long the run is: "generations", or "machines" of a table.
        """
        cost = {"moves": self.moves, "processor_s": round(self.seconds, 1)}
        w = self.policy_class.scale_numbers(cma_numbers).round(4).tolist()
        with path.with_suffix(".csv").open("w", newline="") as file:
            csv.writer(file).writerows(self.rows)
        path.with_suffix(".json").write_text(json.dumps({"w": w, "cost": cost, "length": length}))
        at = {r[0]: np.mean([float(x[3]) for x in self.rows[1:] if x[0] == r[0]]) for r in self.rows[1:]}
        print(f"{path}: {', '.join(f'{k}: {v:.3f}' for k, v in at.items())}; {w}, {cost['processor_s']} s", flush=True)

    def close(self) -> None:
        self.learning.close()
        self.testing.close()


def learn(
    task: str,
    run: int,
    folder: Path,
    generations: int | None = None,
    machines: int = TABLE_MACHINES,
    players: Sequence[str] | None = None,
) -> None:
    """Learn policies of a task with CMA-ES, and write their numbers and their learning curves, unless they exist.

    Args:
        task: Name of a card.
        run: Number of the run, its seed.
        folder: Folder of the files.
        generations: Number of generations; None: that of GENERATIONS_AND_MACHINES.
        machines: Number of machines of the table, for a policy that learns on one.
        players: Names of the players whose policies are learned; None: all of the task.
    """
    folder.mkdir(parents=True, exist_ok=True)
    table, spent = None, 0.0
    for player in (p for t, p in PARAMETRIC_POLICIES if t == task and p in (players or [p])):
        path = folder / f"{task}_{player.replace(' ', '-')}-{run}"
        if path.with_suffix(".json").exists():
            continue
        learner = ParametricPolicyLearner(task, player, run)
        if issubclass(learner.policy_class, SpeedFactorPolicy):
            if table is None:
                start_s = time.process_time()
                table = measure_outcomes_by_speed_factor(task, 1000 * (run + 1), machines)
                spent = time.process_time() - start_s
                print(f"{task} {run}: tried {machines} machines, {spent:.1f} s", flush=True)
            learner.seconds = spent
            learner.write_policy(learner.learn_numbers_on_table(table), path, {"machines": machines})
        else:
            count = generations or learner.generations
            learner.write_policy(learner.learn_numbers(count), path, {"generations": count})
        learner.close()


class ParametricPolicyPlayer:
    """A parametric policy with learned numbers, for `registerbench.play`.

    Args:
        policy_class: Class of the policy.
        numbers: Numbers of the policy.
    """

    def __init__(self, policy_class: type[ParametricPolicy], numbers: list[float]):
        self.policy_class, self.numbers = policy_class, numbers

    def reset(self, policy_context: Any) -> None:
        self.policy = self.policy_class(self.numbers, policy_context.feature_names)

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        return self.policy(observation[None])[0]


def submit(path: Path, splits: list[str], folder: Path, round_: str = OPEN_ROUND) -> None:
    """Play the test episodes of each split with a policy, and write the entries.

    Args:
        path: Policy that `learn` wrote.
        splits: Names of the splits.
        folder: Folder of the entries.
        round_: Round of the benchmark.
    """
    stored, (task, _, name) = json.loads(path.read_text()), path.stem.partition("_")
    method, _, run = name.rpartition("-")
    player = method.replace("-", " ")
    settings = {"memory": "last"} if "memory" in CARDS[task].choices else {}
    training = format_training_command("parametric_policy_learners", method, stored["length"])
    arguments = {"settings": settings, "name": player, "cost": stored["cost"], "round_": round_, "training": training}
    for split in splits:
        write_entry(
            ParametricPolicyPlayer(PARAMETRIC_POLICIES[task, player], stored["w"]),
            task,
            split,
            folder,
            method,
            int(run),
            **arguments,
        )


def enter(args: argparse.Namespace) -> None:
    """Train a run of one policy, and write its entry."""

    def train_and_submit(folder: Path) -> None:
        player = args.method.replace("-", " ")
        learn(args.task, args.run_number, folder, args.generations, args.machines, [player])
        submit(folder / f"{args.task}_{args.method}-{args.run_number}.json", [args.split], folder, args.round)

    write_new_entry(train_and_submit, args.out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    p = commands.add_parser("learn")
    p.add_argument("task", choices=list(dict.fromkeys(task for task, _ in PARAMETRIC_POLICIES)))
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4], metavar="N", help="a run of each")
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: [learn(a.task, run, a.out) for run in a.seeds])
    p = commands.add_parser("submit")
    p.add_argument("policy", type=Path, nargs="+")
    p.add_argument("--splits", nargs="+", default=["train"])
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.add_argument("--round", default=OPEN_ROUND, metavar="WORD", help="whose test episodes (default: the open ones)")
    p.set_defaults(run=lambda a: [submit(path, a.splits, a.out, a.round) for path in a.policy])
    methods = dict.fromkeys(player.replace(" ", "-") for _, player in PARAMETRIC_POLICIES)
    p = add_enter_command(commands, list(methods), list(dict.fromkeys(task for task, _ in PARAMETRIC_POLICIES)))
    p.add_argument("--generations", type=int, metavar="N", help="of a policy that learns in the environments")
    p.add_argument(
        "--machines", type=int, default=TABLE_MACHINES, metavar="N", help="of a policy that learns on a table"
    )
    p.set_defaults(run=enter)
    args = parser.parse_args()
    with exit_on_interrupt("the finished runs are saved, and the same command continues after them."):
        args.run(args)


if __name__ == "__main__":
    main()
