"""What the learners of the benchmark's tasks share: their curves, and their command line."""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper


class EpisodeRecorder(VecEnvWrapper):
    """Notes the sum of rewards and the success of each episode."""

    def __init__(self, envs: Any):
        super().__init__(envs)
        self.totals = np.zeros(envs.num_envs)
        self.done: list[tuple[float, float]] = []

    def reset(self) -> Any:
        self.totals[:] = 0.0
        return self.venv.reset()

    def step_wait(self) -> Any:
        observation, rewards, ends, infos = self.venv.step_wait()
        self.totals += rewards
        for k in np.flatnonzero(ends).tolist():
            self.done.append((float(self.totals[k]), float(infos[k].get("score", {}).get("success", np.nan))))
        self.totals[ends] = 0.0
        return observation, rewards, ends, infos


class LearningCurve(BaseCallback):
    """A row of the curve each `every` steps: steps, processor seconds, episodes, their mean sum of rewards and success."""

    NAMES = ("steps", "processor_s", "episodes", "return", "success")

    def __init__(self, path: Path, every: int = 512):
        super().__init__()
        self.path, self.every, self.next = path, every, every
        self.rows: list[tuple] = [self.NAMES]
        self.start_s = time.process_time()
        path.parent.mkdir(parents=True, exist_ok=True)

    def _on_step(self) -> bool:
        if self.num_timesteps >= self.next:
            self.next = self.num_timesteps + self.every
            envs: Any = self.training_env
            done, envs.done = envs.done, []
            means = np.mean(done, axis=0) if done else (np.nan, np.nan)
            spent = time.process_time() - self.start_s
            self.rows.append((self.num_timesteps, f"{spent:.1f}", len(done), f"{means[0]:.4f}", f"{means[1]:.4f}"))
            with self.path.open("w", newline="") as file:
                csv.writer(file).writerows(self.rows)
        return True


def read_cost(policy: Path) -> dict[str, float]:
    """Return what a policy took to learn, from its curve: moves, and processor seconds."""
    with policy.with_suffix(".csv").open() as file:
        *_, last = csv.DictReader(file)
    return {"moves": float(last["steps"]), "processor_s": float(last["processor_s"])}


def compute_wilson_interval(won: int, of: int, z: float = 1.96) -> tuple[float, float]:
    """Compute the share of successes and its interval by Wilson's score.

    Args:
        won: Successes.
        of: Trials.
        z: Of the normal distribution; 1.96 for 95 %.
    """
    share, more = won / of, z * z / of
    half = z * np.sqrt(share * (1 - share) / of + more / (4 * of))
    return float((share + more / 2 - half) / (1 + more)), float((share + more / 2 + half) / (1 + more))


def save(model: Any, path: Path, steps: int) -> None:
    """Save a policy to a file of the learner's own, and the cost of its learning beside it."""
    model.save(path.with_suffix(".zip"))
    print(f"{path}.zip: {steps} steps", flush=True)


def make_parser(
    doc: str | None,
    methods: Sequence[str],
    steps: float,
    learn: Callable[..., None],
    submit: Callable[[Path, list[str], list[str], Path], None],
    tasks: Sequence[str],
    levels: Sequence[str] = (),
    evaluate: Callable[[Path], None] | None = None,
) -> argparse.ArgumentParser:
    """Return the parser of a learner: `learn METHOD`, `submit POLICY`, and `evaluate POLICY` where there is one.

    Args:
        doc: Description of the program.
        methods: Names.
        steps: Of learning; for a learner with levels, a factor of the steps of each.
        learn: Called for `learn`.
        submit: Called for `submit`.
        tasks: Of the bench.
        levels: Names, easiest first.
        evaluate: Called for `evaluate`, or None.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    p = commands.add_parser("learn")
    p.add_argument("method", choices=methods)
    p.add_argument("--seed", type=int, default=0)
    if levels:
        p.add_argument("--times", type=float, default=steps, metavar="X", help="as many steps as it has")
    else:
        p.add_argument("--steps", type=int, default=steps)
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    if levels:
        p.add_argument("--level", choices=levels, default=levels[0], help="at which its curriculum ends")
    p.set_defaults(run=lambda a: learn(a.method, a.seed, *([a.times, a.level] if levels else [a.steps]), a.out))
    if evaluate is not None:
        p = commands.add_parser("evaluate")
        p.add_argument("policy", type=Path, nargs="+")
        p.set_defaults(run=lambda a: [evaluate(path) for path in a.policy])
    p = commands.add_parser("submit")
    p.add_argument("policy", type=Path, nargs="+")
    p.add_argument("--splits", nargs="+", default=["train"])
    p.add_argument("--tasks", nargs="+", default=list(tasks), choices=tasks)
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: [submit(path, a.splits, a.tasks, a.out) for path in a.policy])
    return parser
