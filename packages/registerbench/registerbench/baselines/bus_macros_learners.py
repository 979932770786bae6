"""Learners from scratch on `stage/BusMacros-v1`: DQN and PPO, both with the action mask.

python -m registerbench.baselines.bus_macros_learners learn dqn --seed 0 --level axes -o runs
python -m registerbench.baselines.bus_macros_learners evaluate runs/target-dqn-0.zip runs/axes-dqn-0.zip
python -m registerbench.baselines.bus_macros_learners submit runs/target-dqn-0.zip --tasks bus-target -o entries

Both see axes by their role (bus_macros_axis_roles.py): what was learned of one can be done with each.

dqn   double DQN with returns of five macros (bus_macros_dqn.py). It explores anew at each level; what it has learned acts by the
      softmax of its values
ppo   MaskablePPO of sb3-contrib; for one axis it took some eight times as many macros

A curriculum up to --level, with easier episodes mixed in. From time to time (EVERY) the policy plays VALIDATION machines of
train, on which it does not learn. A level ends when it has solved MASTERED of them, or when its steps are spent; its best policy
goes on, and the temperature at which that one acts is chosen on the same machines.

Learning has settings of its own for what the task lets one choose; validation and tests have the task's own. A macro costs MACRO,
that dawdling shows. The way of an axis is worth as much at each level (PROGRESS; the task has the mean of the axes), so that a
step of it pays for its macros. `discount` is the task's 1, not the learner's GAMMA: with that, all is paid at the end, and before
it a loan on it that is less than half as large, so a policy that does not yet succeed has less to go by. (Once it paid for standing
far away, too, and such a policy went round in circles of macros that move nothing.)

`learn` writes for each level the policy, its temperature, and the curve so far: a CSV with a row for each of these times. A run of
the same seed learns the same again. `evaluate` plays the test episodes of a policy's level, by the ways that the targets lie.
`submit` plays those of the bench and packs them, see docs/benchmark.md. Needs the extra `rl`.
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

from registerbench.baselines import explain_interrupt
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.bus_macros_axis_roles import AxisRoles, AxisRolesVecEnv, MixedLevelsVecEnv
from registerbench.baselines.bus_macros_dqn import MaskedDQN, dqn
from registerbench.baselines.learner_support import compute_wilson_interval, make_parser, read_cost
from registerbench.cards import FIRST_TEST_SEED
from stage.envs.sb3 import StageVecEnv

ID = "stage/BusMacros-v1"
TASKS = ("bus-target", "bus-axes", "bus")
LEVELS = {"target": 163_840, "axes": 262_144, "origin": 393_216}
"""Steps of each at most, of which so many times as many with PPO."""
PPO_STEPS_FACTOR = {"dqn": 1, "ppo": 8}
LANES = {"dqn": 32, "ppo": 64}
GAMMA, MACRO_COST = 0.99, 0.03  # of learning
PROGRESS = {"target": 2.0, "axes": 4.0, "origin": 4.0}
TEMPERATURE = (
    0.05  # of a policy while it learns: macros that are nearly worth the same take turns, so none goes round in circles
)
TEMPERATURES = (TEMPERATURE, 0.02, 0.1, 0.005)  # of those that do equally well the first
VALIDATION, FROM, MASTERED = 64, 900_000, 63  # machines; their first seed; so many of them
EPISODES = 64  # of a test
VALIDATION_INTERVAL_STEPS = {
    "target": 8_192,
    "axes": 8_192,
    "origin": 24_576,
}  # steps, of which origin's are the dearest


def make_learning_envs(method: str, level: str, seed: int) -> Any:
    settings = {"level": level, "macro_weight": MACRO_COST, "progress_weight": PROGRESS[level]}
    envs: Any = StageVecEnv(ID, LANES[method], threads=1, **settings)
    return AxisRolesVecEnv(MixedLevelsVecEnv(envs, level, seed), append_mask=method == "dqn")


def model_of(method: str, envs: Any, seed: int) -> Any:
    if method == "dqn":
        return dqn(envs, GAMMA, seed)
    return MaskablePPO(
        "MlpPolicy", envs, n_steps=64, batch_size=1024, n_epochs=6, learning_rate=7e-4, gamma=GAMMA, ent_coef=0.01,
        policy_kwargs={"net_arch": [128, 128]}, seed=seed, device="cpu",
    )  # fmt: skip


class MacroPolicy:
    """A learner's policy, for registerbench."""

    def __init__(self, method: str, model: Any, temperature: float = TEMPERATURE):
        self.method, self.model, self.temperature = method, model, temperature
        self.turn: AxisRoles | None = None
        self.draw = np.random.default_rng(0)

    @classmethod
    def load(cls, path: Path) -> MacroPolicy:
        """Load a file that `learn` wrote: LEVEL-METHOD-SEED.zip."""
        method = path.stem.split("-")[1]
        kind: Any = MaskablePPO if method == "ppo" else MaskedDQN
        torch.manual_seed(0)
        stored = json.loads(path.with_suffix(".json").read_text())
        return cls(method, kind.load(path, device="cpu"), stored["temperature"])

    def reset(self, context: Any) -> None:
        """around.entries has the names of what is seen."""
        self.turn = AxisRoles(context.feature_names, self.model.action_space.n)

    def choose(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Macros, (n,)."""
        axis = self.turn.find_selected_axis(observations)
        observation, masks = self.turn.reorder_observation(observations, axis), self.turn.reorder_masks(masks, axis)
        if self.method == "ppo":
            macros = self.model.predict(observation, deterministic=False, action_masks=masks > 0)[0]
        else:
            with torch.no_grad():
                worth = self.model.q_net(
                    torch.as_tensor(np.concatenate([observation, masks], axis=1, dtype=np.float32))
                )
            macros = (worth.numpy() / self.temperature + self.draw.gumbel(size=worth.shape)).argmax(axis=1)
        return self.turn.restore_macros(macros, axis)

    def __call__(self, observation: np.ndarray, info: Any) -> int:
        return int(self.choose(observation[None], np.asarray(info["action_mask"])[None])[0])


class PolicyValidator:
    """Machines on which policies of a level are played with the task's own settings: those of the seeds first, first + 1, ..."""

    def __init__(self, level: str, first: int, machines: int):
        self.envs, self.first, self.machines = StageVecEnv(ID, machines, threads=1, level=level), first, machines
        self.directions: list[str] = []

    def play(self, policy: MacroPolicy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Play an episode on each machine, and return what was solved, the macros, and the returns, (machines,) each."""
        n, envs = self.machines, self.envs.envs
        policy.turn = AxisRoles([e.name for e in envs.observation_features], envs.single_action_space.n)
        policy.draw = np.random.default_rng(0)
        self.envs.seed(self.first)
        observation, states = self.envs.reset(), envs.task_instance.axis_states
        used = envs.task_instance.uses_axis[0]
        self.directions = ["".join("-+"[int(t > 0)] for t in row) for row in states["target"][:, used].tolist()]
        won, moves, total, left = np.zeros(n, bool), np.zeros(n, int), np.zeros(n), np.ones(n, bool)
        while left.any():
            observation, rewards, ends, infos = self.envs.step(policy.choose(observation, envs.action_masks()))
            total += np.where(left, rewards, 0.0)
            for k in np.flatnonzero(ends & left):
                won[k], moves[k] = infos[k]["score"]["success"], infos[k]["score"]["moves"]
            left &= ~ends
        return won, moves, total

    def close(self) -> None:
        self.envs.close()


class ValidationCallback(BaseCallback):
    """Rows of the curve, by the machines of validation; keeps the best policy, and ends the level when it is mastered."""

    NAMES = ("steps", "processor_s", "episodes", "return", "success", "level")

    def __init__(self, method: str, path: Path):
        super().__init__()
        self.method, self.path = method, path
        self.rows: list[tuple] = []
        self.start_s = time.process_time()
        path.parent.mkdir(parents=True, exist_ok=True)

    def level(self, name: str, path: Path) -> None:
        self.name, self.path, self.best, self.best_state = name, path, -1.0, None
        self.next = self.num_timesteps + VALIDATION_INTERVAL_STEPS[name]
        self.judge = PolicyValidator(name, FROM, VALIDATION)

    def _on_step(self) -> bool:
        if self.num_timesteps < self.next:
            return True
        self.next = self.num_timesteps + VALIDATION_INTERVAL_STEPS[self.name]
        won, _, total = self.judge.play(MacroPolicy(self.method, self.model))
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
        """The model is the level's best again; the temperature at which that one acts best, and what it does there."""
        self.model.policy.load_state_dict(self.best_state)
        solved = {}
        for temperature in TEMPERATURES if self.method == "dqn" else (TEMPERATURE,):
            solved[temperature] = int(self.judge.play(MacroPolicy(self.method, self.model, temperature))[0].sum())
        self.judge.close()
        best = max(solved, key=lambda t: solved[t])
        print(f"{self.path}: validation {solved}", flush=True)
        return {"temperature": best, "validated": solved[best]}


def learn(method: str, seed: int, times: float, top: str, folder: Path) -> None:
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    model, callback = None, ValidationCallback(method, folder)
    for level, steps in list(LEVELS.items())[: list(LEVELS).index(top) + 1]:
        path, envs = folder / f"{level}-{method}-{seed}", make_learning_envs(method, level, seed)
        callback.level(level, path)
        if model is None:
            model = model_of(method, envs, seed)
        else:
            model.set_env(envs)
            if method == "dqn":
                model.start_level()
        envs.seed(10_000 * (seed + 1) + 1_000 * list(LEVELS).index(level))
        model.learn(int(steps * PPO_STEPS_FACTOR[method] * times), callback=callback, reset_num_timesteps=False)
        path.with_suffix(".json").write_text(json.dumps(callback.choose_temperature()))
        envs.close()
        model.save(path.with_suffix(".zip"))


def evaluate(path: Path) -> None:
    """Success on the test episodes of the policy's level, by the signs of the targets of x and y."""
    torch.set_num_threads(1)
    level, method, run = path.stem.split("-")
    judge = PolicyValidator(level, FIRST_TEST_SEED, EPISODES)
    won, moves, _ = judge.play(MacroPolicy.load(path))
    judge.close()
    of = {way: won[[w == way for w in judge.directions]] for way in sorted(set(judge.directions))}
    each = ", ".join(f"{way} {found.sum()} of {len(found)}" for way, found in of.items())
    spent, (low, high) = read_cost(path), compute_wilson_interval(int(won.sum()), EPISODES)
    print(
        f"| {level} | {method} | {run} | {spent['moves']:.0f} | {spent['processor_s']:.0f} | {won.sum()} of {EPISODES} "
        f"({low:.0%} to {high:.0%}) | {each} | {moves[won].mean() if won.any() else np.nan:.1f} |",
        flush=True,
    )


def submit(path: Path, splits: list[str], tasks: list[str], folder: Path) -> None:
    torch.set_num_threads(1)
    _, method, run = path.stem.split("-")
    how = {"name": f"{method}-masked", "cost": read_cost(path)}
    for task, split in product(tasks, splits):
        write_entry(MacroPolicy.load(path), task, split, folder, method, int(run), **how)


if __name__ == "__main__":
    parser = make_parser(__doc__, ("dqn", "ppo"), 1.0, learn, submit, TASKS, tuple(LEVELS), evaluate)
    args = parser.parse_args()
    with explain_interrupt(
        "levels that are done have their policies, all their curves; the same command learns the run anew."
    ):
        args.run(args)
