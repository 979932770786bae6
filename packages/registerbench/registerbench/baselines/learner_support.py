"""Parts that the learners of the benchmark's tasks share: learning curves, and the command line."""

from __future__ import annotations

import argparse
import csv
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper

from registerbench.baselines.training_commands import add_enter_command, format_training_command, write_new_entry
from registerbench.benchmark_tasks import OPEN_ROUND


class EpisodeRecorder(VecEnvWrapper):
    """Wrapper that records the sum of rewards and the success of each episode in `done`."""

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


class LearningCurveWriter(BaseCallback):
    """Callback that writes a row of the learning curve each `every` steps.

    A row has the steps, the processor seconds, and the number, mean return and success rate of the episodes since the last row.

    Args:
        path: CSV file.
        every: Number of steps between two rows.
    """

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
    """Read from the learning curve of a policy how many moves and processor seconds its training took."""
    with policy.with_suffix(".csv").open() as file:
        *_, last = csv.DictReader(file)
    return {"moves": float(last["steps"]), "processor_s": float(last["processor_s"])}


def compute_wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Compute Wilson's score interval of a success rate.

    Args:
        successes: Number of successes.
        trials: Number of trials.
        z: Quantile of the normal distribution; 1.96 for 95 %.

    Returns:
        Lower and upper end, 0 to 1.
    """
    share, more = successes / trials, z * z / trials
    half = z * np.sqrt(share * (1 - share) / trials + more / (4 * trials))
    return float((share + more / 2 - half) / (1 + more)), float((share + more / 2 + half) / (1 + more))


def save_policy(model: Any, path: Path, steps: int) -> None:
    """Save a model as a ZIP file and the number of its steps as JSON, and print its path.

    Args:
        model: Model of Stable-Baselines3.
        path: File without its suffix.
        steps: Number of steps of its training.
    """
    model.save(path.with_suffix(".zip"))
    path.with_suffix(".json").write_text(json.dumps({"steps": steps}))
    print(f"{path}.zip: {steps} steps", flush=True)


def read_training(policy: Path, module: str, method: str, names: Sequence[str] = ("steps",)) -> str:
    """Return the training command of the entries of a policy, with the options that its JSON file states.

    Args:
        policy: Policy that `learn` wrote.
        module: Name of the learner's module.
        method: Name of the method.
        names: Names of the options.
    """
    stored = json.loads(policy.with_suffix(".json").read_text())
    return format_training_command(module, method, {name: stored[name] for name in names})


def make_parser(
    doc: str | None,
    methods: Sequence[str],
    steps: float,
    learn: Callable[..., None],
    submit: Callable[[Path, list[str], list[str], Path, str], None],
    tasks: Sequence[str],
    levels: Sequence[str] = (),
    evaluate: Callable[[Path], None] | None = None,
) -> argparse.ArgumentParser:
    """Make the parser of a learner with the commands `learn`, `submit`, `enter` (see training_commands.py) and perhaps `evaluate`.

    Args:
        doc: Description of the program.
        methods: Names of the methods.
        steps: Default number of steps; for a learner with levels, default factor on the steps of each level.
        learn: Function for `learn`.
        submit: Function for `submit`.
        tasks: Names of the cards that `submit` can play.
        levels: Names of the levels, the easiest first; empty for a learner without levels.
        evaluate: Function for `evaluate`, or None.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    p = commands.add_parser("learn")
    p.add_argument("method", choices=methods)
    p.add_argument("--seed", type=int, default=0)
    _add_length_options(p, steps, levels)
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: learn(a.method, a.seed, *_get_length(a, levels), a.out))
    if evaluate is not None:
        p = commands.add_parser("evaluate")
        p.add_argument("policy", type=Path, nargs="+")
        p.set_defaults(run=lambda a: [evaluate(path) for path in a.policy])
    p = commands.add_parser("submit")
    p.add_argument("policy", type=Path, nargs="+")
    p.add_argument("--splits", nargs="+", default=["train"])
    p.add_argument("--tasks", nargs="+", default=list(tasks), choices=tasks)
    p.add_argument("--round", default=OPEN_ROUND, metavar="WORD", help="whose test episodes (default: the open ones)")
    p.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    p.set_defaults(run=lambda a: [submit(path, a.splits, a.tasks, a.out, a.round) for path in a.policy])
    p = add_enter_command(commands, list(methods), list(tasks))
    _add_length_options(p, steps, levels)

    def enter(a: argparse.Namespace) -> None:
        """Train a run, and write its entry."""

        def train_and_submit(folder: Path) -> None:
            learn(a.method, a.run_number, *_get_length(a, levels), folder)
            name = f"{a.level}-{a.method}" if levels else a.method
            (policy,) = folder.glob(f"*{name}-{a.run_number}.zip")
            submit(policy, [a.split], [a.task], folder, a.round)

        write_new_entry(train_and_submit, a.out)

    p.set_defaults(run=enter)
    return parser


def _add_length_options(p: argparse.ArgumentParser, steps: float, levels: Sequence[str]) -> None:
    """Add the options that determine how long a run is; see `make_parser`."""
    if levels:
        p.add_argument("--times", type=float, default=steps, metavar="X", help="as many steps as it has")
        p.add_argument("--level", choices=levels, default=levels[0], help="at which its curriculum ends")
    else:
        p.add_argument("--steps", type=int, default=steps)


def _get_length(args: argparse.Namespace, levels: Sequence[str]) -> list[Any]:
    """Return the arguments of `learn` that determine how long a run is."""
    return [args.times, args.level] if levels else [args.steps]
