"""Learners from scratch on `stage/BusMacros-v1`: DQN and PPO, both with the action mask.

python -m registerbench.baselines.bus_macros_learners learn dqn --seed 0 --level axes -o runs
python -m registerbench.baselines.bus_macros_learners evaluate runs/target-dqn-0.zip runs/axes-dqn-0.zip
python -m registerbench.baselines.bus_macros_learners submit runs/target-dqn-0.zip --tasks bus-target -o entries

Both observe the axes by their role (bus_macros_role_order.py), so they can apply what they learn on one axis to each.

dqn   double DQN with returns of five macros (bus_macros_dqn.py). It raises its exploration rate at each level. The learned
      policy acts by the softmax of its values
ppo   MaskablePPO of sb3-contrib. For one axis it needed about eight times as many macros

A run is a curriculum of the levels up to --level, with easier episodes mixed in. Every VALIDATION_INTERVAL_STEPS the policy plays
VALIDATION machines of the split train on which it does not learn. A level ends when the policy has solved MASTERED of them, or
when its steps are spent. The next level continues with the best policy, whose temperature is chosen on the same machines.

Learning changes some settings of the task; validation and tests use the task's own. A macro costs MACRO_COST, so that
unnecessary macros lower the return. The travel of an axis pays the same at each level (PROGRESS_WEIGHTS; the task takes
the mean of the
axes), so that a step of it pays for its macros. The setting `discount` remains 1: with the learner's GAMMA, nearly all of the
reward would come at the end of an episode, and a policy that does not yet succeed would have little reward to learn from.

`learn` writes for each level the policy, its temperature with the length of the run, and the curve so far: a CSV file with a row
for each validation. A run with the same seed learns the same policy again. `evaluate` plays the test episodes of a policy's
level, and counts successes by the directions of the targets. `submit` plays the test episodes of the benchmark and packs them,
see docs/benchmark.md. Needs the extra `rl`.
"""

from __future__ import annotations

import copy
import csv
import json
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback

from registerbench.baselines import exit_on_interrupt
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.bus_macros_dqn import MaskedDQN, make_dqn
from registerbench.baselines.bus_macros_role_order import AxisRoles, AxisRolesVecEnv, MixedLevelsVecEnv
from registerbench.baselines.learner_support import compute_wilson_interval, make_parser, read_cost, read_training
from registerbench.benchmark_tasks import BUS_TIME, FIRST_TEST_SEED, OPEN_ROUND
from stage.envs.sb3 import StageVecEnv

ID = "stage/BusMacros-v1"
TASKS = ("bus-target", "bus-axes", "bus")
MAX_STEPS_BY_LEVEL = {"target": 163_840, "axes": 262_144, "origin": 393_216}
"""Largest number of steps by level, for DQN."""
PPO_STEPS_FACTOR = {"dqn": 1, "ppo": 8}
"""Factor on the steps of a level by method."""
PARALLEL_ENVS = {"dqn": 32, "ppo": 64}
GAMMA, MACRO_COST = 0.99, 0.03
PROGRESS_WEIGHTS = {"target": 2.0, "axes": 4.0, "origin": 4.0}
TEMPERATURE = (
    0.05  # of a policy during learning: it varies macros of nearly equal value, and so does not repeat a cycle
)
TEMPERATURES = (TEMPERATURE, 0.02, 0.1, 0.005)  # the first of the best ones is chosen
VALIDATION, FIRST_VALIDATION_SEED, MASTERED = 64, 900_000, 63  # MASTERED: solved machines that end a level
EPISODES = 64  # of a test
VALIDATION_INTERVAL_STEPS = {"target": 8_192, "axes": 8_192, "origin": 24_576}  # episodes of origin are the longest


def make_learning_envs(method: str, level: str, seed: int) -> Any:
    """Make the environments in which a method learns a level.

    Args:
        method: "dqn" or "ppo".
        level: Name of the level.
        seed: Seed of the mixed-in easier episodes.
    """
    settings = {"level": level, "macro_weight": MACRO_COST, "progress_weight": PROGRESS_WEIGHTS[level], **BUS_TIME}
    envs: Any = StageVecEnv(ID, PARALLEL_ENVS[method], threads=1, **settings)
    return AxisRolesVecEnv(MixedLevelsVecEnv(envs, level, seed), append_mask=method == "dqn")


def make_model(method: str, envs: Any, seed: int) -> Any:
    """Make the untrained model of a method.

    Args:
        method: "dqn" or "ppo".
        envs: Environments of learning.
        seed: Seed of the model.
    """
    if method == "dqn":
        return make_dqn(envs, GAMMA, seed)
    return MaskablePPO(
        "MlpPolicy", envs, n_steps=64, batch_size=1024, n_epochs=6, learning_rate=7e-4, gamma=GAMMA, ent_coef=0.01,
        policy_kwargs={"net_arch": [128, 128]}, seed=seed, device="cpu",
    )  # fmt: skip


class MacroPolicy:
    """Learned policy on BusMacros, for `registerbench.play`.

    Args:
        method: "dqn" or "ppo".
        model: Learned model.
        temperature: Temperature of the softmax over the values of DQN.
    """

    def __init__(self, method: str, model: Any, temperature: float = TEMPERATURE):
        self.method, self.model, self.temperature = method, model, temperature
        self.axis_roles: AxisRoles | None = None
        self.draw = np.random.default_rng(0)

    @classmethod
    def load(cls, path: Path) -> MacroPolicy:
        """Load a policy from the file LEVEL-METHOD-SEED.zip that `learn` wrote."""
        method = path.stem.split("-")[1]
        kind: Any = MaskablePPO if method == "ppo" else MaskedDQN
        torch.manual_seed(0)
        stored = json.loads(path.with_suffix(".json").read_text())
        return cls(method, kind.load(path, device="cpu"), stored["temperature"])

    def reset(self, policy_context: Any) -> None:
        """Prepare for an episode; `policy_context.feature_names` names the features of its observations."""
        self.axis_roles = AxisRoles(policy_context.feature_names, self.model.action_space.n)

    def choose_macros(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Choose a macro for each observation.

        Args:
            observations: Observations, (n, features).
            masks: Action masks, (n, macros).

        Returns:
            Indices of macros, (n,).
        """
        axis = self.axis_roles.find_selected_axis(observations)
        observation, masks = (
            self.axis_roles.reorder_observation(observations, axis),
            self.axis_roles.reorder_masks(masks, axis),
        )
        if self.method == "ppo":
            macros = self.model.predict(observation, deterministic=False, action_masks=masks > 0)[0]
        else:
            with torch.no_grad():
                worth = self.model.q_net(
                    torch.as_tensor(np.concatenate([observation, masks], axis=1, dtype=np.float32))
                )
            macros = (worth.numpy() / self.temperature + self.draw.gumbel(size=worth.shape)).argmax(axis=1)
        return self.axis_roles.restore_macros(macros, axis)

    def __call__(self, observation: np.ndarray, info: Any) -> int:
        return int(self.choose_macros(observation[None], np.asarray(info["action_mask"])[None])[0])


class PolicyValidator:
    """Validation machines of a level, with the task's own settings.

    Args:
        level: Name of the level.
        first: Seed of the first machine; the others have the next seeds.
        machines: Number of machines.
    """

    def __init__(self, level: str, first: int, machines: int):
        self.envs, self.first, self.machines = (
            StageVecEnv(ID, machines, threads=1, level=level, **BUS_TIME),
            first,
            machines,
        )
        self.directions: list[str] = []

    def play(self, policy: MacroPolicy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Play an episode of BusMacros with a policy on each validation machine.

        Returns:
            Successes, numbers of macros (actions) in the episodes, and sums of rewards; arrays of shape (machines,).
        """
        n, envs = self.machines, self.envs.envs
        policy.axis_roles = AxisRoles([e.name for e in envs.observation_features], envs.single_action_space.n)
        policy.draw = np.random.default_rng(0)
        self.envs.seed(self.first)
        observation, states = self.envs.reset(), envs.task_instance.axis_states
        used = envs.task_instance.uses_axis[0]
        self.directions = ["".join("-+"[int(t > 0)] for t in row) for row in states["target"][:, used].tolist()]
        won, moves, total, left = np.zeros(n, bool), np.zeros(n, int), np.zeros(n), np.ones(n, bool)
        while left.any():
            observation, rewards, ends, infos = self.envs.step(policy.choose_macros(observation, envs.action_masks()))
            total += np.where(left, rewards, 0.0)
            for k in np.flatnonzero(ends & left):
                won[k], moves[k] = infos[k]["score"]["success"], infos[k]["score"]["moves"]
            left &= ~ends
        return won, moves, total

    def close(self) -> None:
        self.envs.close()


class ValidationCallback(BaseCallback):
    """Callback that validates the policy, writes the learning curve, stores the best policy, and ends a mastered level.

    Args:
        method: "dqn" or "ppo".
        path: File of the curve, without its suffix.
    """

    NAMES = ("steps", "processor_s", "episodes", "return", "success", "level")

    def __init__(self, method: str, path: Path):
        super().__init__()
        self.method, self.path = method, path
        self.rows: list[tuple] = []
        self.start_s = time.process_time()
        path.parent.mkdir(parents=True, exist_ok=True)

    def begin_level(self, name: str, path: Path) -> None:
        """Begin a level with its own validation machines and curve.

        Args:
            name: Name of the level.
            path: File of the curve, without its suffix.
        """
        self.name, self.path, self.best, self.best_state = name, path, -1.0, None
        self.next = self.num_timesteps + VALIDATION_INTERVAL_STEPS[name]
        self.validator = PolicyValidator(name, FIRST_VALIDATION_SEED, VALIDATION)

    def _on_step(self) -> bool:
        if self.num_timesteps < self.next:
            return True
        self.next = self.num_timesteps + VALIDATION_INTERVAL_STEPS[self.name]
        won, _, total = self.validator.play(MacroPolicy(self.method, self.model))
        spent = f"{time.process_time() - self.start_s:.1f}"
        row = (self.num_timesteps, spent, VALIDATION, f"{total.mean():.4f}", f"{won.mean():.4f}", self.name)
        self.rows.append(row)
        print(*row, flush=True)
        with self.path.with_suffix(".csv").open("w", newline="") as file:
            csv.writer(file).writerows([self.NAMES, *self.rows])
        worth = won.sum() + total.mean() * 1e-3
        if worth > self.best:
            self.best, self.best_state = worth, copy.deepcopy(self.model.policy.state_dict())
        return bool(won.sum() < MASTERED)

    def choose_temperature(self) -> dict[str, float]:
        """Restore the best policy of the level, and choose the temperature at which it solves the most machines.

        Returns:
            "temperature" and "validated", the number of machines that the policy solves with it.
        """
        self.model.policy.load_state_dict(self.best_state)
        solved = {}
        for temperature in TEMPERATURES if self.method == "dqn" else (TEMPERATURE,):
            solved[temperature] = int(self.validator.play(MacroPolicy(self.method, self.model, temperature))[0].sum())
        self.validator.close()
        best = max(solved, key=lambda t: solved[t])
        print(f"{self.path}: validation {solved}", flush=True)
        return {"temperature": best, "validated": solved[best]}


def learn(method: str, seed: int, times: float, top: str, folder: Path) -> None:
    """Learn the levels of the curriculum one after the other, and write the policy and the curve of each.

    Args:
        method: "dqn" or "ppo".
        seed: Seed of the run.
        times: Factor on the steps of each level.
        top: Last level of the curriculum.
        folder: Folder of the files.
    """
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    model, callback = None, ValidationCallback(method, folder)
    for level, steps in list(MAX_STEPS_BY_LEVEL.items())[: list(MAX_STEPS_BY_LEVEL).index(top) + 1]:
        path, envs = folder / f"{level}-{method}-{seed}", make_learning_envs(method, level, seed)
        callback.begin_level(level, path)
        if model is None:
            model = make_model(method, envs, seed)
        else:
            model.set_env(envs)
            if method == "dqn":
                model.restart_exploration()
        envs.seed(10_000 * (seed + 1) + 1_000 * list(MAX_STEPS_BY_LEVEL).index(level))
        model.learn(int(steps * PPO_STEPS_FACTOR[method] * times), callback=callback, reset_num_timesteps=False)
        stored = {**callback.choose_temperature(), "times": times, "level": level}
        path.with_suffix(".json").write_text(json.dumps(stored))
        envs.close()
        model.save(path.with_suffix(".zip"))


def evaluate(path: Path) -> None:
    """Print the successes on the test episodes of the policy's level, by the directions of the targets of x and y."""
    torch.set_num_threads(1)
    level, method, run = path.stem.split("-")
    judge = PolicyValidator(level, FIRST_TEST_SEED, EPISODES)
    won, moves, _ = judge.play(MacroPolicy.load(path))
    judge.close()
    directions = np.array(judge.directions)
    by_direction = {d: won[directions == d] for d in sorted(set(judge.directions))}
    each = ", ".join(f"{d} {successes.sum()} of {len(successes)}" for d, successes in by_direction.items())
    spent, (low, high) = read_cost(path), compute_wilson_interval(int(won.sum()), EPISODES)
    print(
        f"| {level} | {method} | {run} | {spent['moves']:.0f} | {spent['processor_s']:.0f} | {won.sum()} of {EPISODES} "
        f"({low:.0%} to {high:.0%}) | {each} | {moves[won].mean() if won.any() else np.nan:.1f} |",
        flush=True,
    )


def submit(path: Path, splits: list[str], tasks: list[str], folder: Path, round_: str = OPEN_ROUND) -> None:
    """Play the test episodes with a policy, and write an entry for each task and split.

    Args:
        path: Policy that `learn` wrote.
        splits: Names of the splits.
        tasks: Names of the cards.
        folder: Folder of the entries.
        round_: Round of the benchmark.
    """
    torch.set_num_threads(1)
    _, method, run = path.stem.split("-")
    training = read_training(path, "bus_macros_learners", method, ("times", "level"))
    settings = {"name": f"{method}-masked", "cost": read_cost(path), "training": training, "round_": round_}
    for task, split in product(tasks, splits):
        write_entry(MacroPolicy.load(path), task, split, folder, method, int(run), **settings)


if __name__ == "__main__":
    parser = make_parser(__doc__, ("dqn", "ppo"), 1.0, learn, submit, TASKS, tuple(MAX_STEPS_BY_LEVEL), evaluate)
    args = parser.parse_args()
    with exit_on_interrupt(
        "the policies of finished levels and all curves are saved; the same command learns the whole run again."
    ):
        args.run(args)
