"""Learners from scratch on `stage/BusMacros-v1`: PPO and DQN, both with the action mask.

python scripts/baselines/bus_macros_learners.py learn ppo --seed 0 -o runs
python scripts/baselines/bus_macros_learners.py learn ppo --seed 0 --level origin -o runs
python scripts/baselines/bus_macros_learners.py submit runs/target-ppo-0.zip -o entries

ppo   MaskablePPO of sb3-contrib
dqn   DQN of Stable-Baselines3; the mask is part of what the network sees, and takes masked actions out of every maximum

A curriculum up to --level: each of LEVELS for so many steps, with the earlier ones mixed in. `learn` writes the policy and
its curve, a CSV with a row a batch. `submit` plays the test episodes of splits and packs them, see docs/benchmark.md.
Needs the extra `rl`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from learning import Curve, Noted, cost_of, parser_of, save
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

from stage import bench
from stage.envs.sb3 import StageVecEnv

ID = "stage/BusMacros-v1"
TASKS = ("bus-target", "bus")
LEVELS = ("target", "axes", "origin")
STEPS, LANES = 98_304, 16  # steps of a level


class Masked(VecEnvWrapper):
    """The mask behind the observation."""

    def __init__(self, envs: Any):
        space: Any = envs.observation_space
        size = space.shape[0] + envs.action_space.n
        super().__init__(envs, gymnasium.spaces.Box(-1.0, 1.0, (size,), np.float32))

    def _with(self, seen: Any, masks: Any) -> np.ndarray:
        return np.concatenate([seen, np.asarray(masks, np.float32)], axis=-1)

    def reset(self) -> np.ndarray:
        return self._with(self.venv.reset(), self.venv.env_method("action_masks"))

    def step_wait(self) -> Any:
        seen, rewards, ends, infos = self.venv.step_wait()
        for k in np.flatnonzero(ends):
            infos[k]["terminal_observation"] = self._with(infos[k]["terminal_observation"], infos[k]["action_mask"])
        return self._with(seen, self.venv.env_method("action_masks")), rewards, ends, infos


class MaskedNetwork(QNetwork):
    """What a masked action is worth: nothing would choose it."""

    def forward(self, obs: Any) -> torch.Tensor:
        values = super().forward(obs)
        return torch.where(obs[:, -values.shape[1] :] > 0.5, values, torch.full_like(values, -1e6))


class MaskedPolicy(DQNPolicy):
    def make_q_net(self) -> QNetwork:
        args = self._update_features_extractor(self.net_args, features_extractor=None)
        return MaskedNetwork(**args).to(self.device)


class MaskedDQN(DQN):
    """Explores among what is not masked."""

    draw = np.random.default_rng(0)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> Any:
        chosen, state = super().predict(observation, state, episode_start, deterministic=True)
        if not deterministic and self.draw.random() < self.exploration_rate:
            masks = np.atleast_2d(observation)[:, -self.action_space.n :] > 0.5  # type: ignore[attr-defined]
            chosen = np.array([self.draw.choice(np.flatnonzero(m)) for m in masks])
        return chosen, state

    def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> Any:
        chosen, _ = self.predict(self._last_obs, deterministic=False)
        return chosen, chosen


def vector(method: str, level: str, threads: int = 1) -> Any:
    envs: Any = StageVecEnv(ID, LANES, threads=threads, level=level, mixed=True)
    return Noted(envs if method == "ppo" else Masked(envs))


def model_of(method: str, envs: Any, seed: int) -> Any:
    nets: dict[str, Any] = {"net_arch": [128, 128]}
    if method == "ppo":
        return MaskablePPO(
            "MlpPolicy", envs, n_steps=128, batch_size=512, n_epochs=8, learning_rate=7e-4, gamma=0.99, ent_coef=0.01,
            policy_kwargs=nets, seed=seed, device="cpu",
        )  # fmt: skip
    return MaskedDQN(
        MaskedPolicy, envs, buffer_size=200_000, learning_starts=5_000, batch_size=256, learning_rate=5e-4, gamma=0.99,
        train_freq=4, gradient_steps=16, target_update_interval=4_000, exploration_fraction=0.4, exploration_final_eps=0.05,
        policy_kwargs=nets, seed=seed, device="cpu",
    )  # fmt: skip


def learn(method: str, seed: int, steps: int, top: str, folder: Path) -> None:
    torch.set_num_threads(1)
    MaskedDQN.draw = np.random.default_rng(seed)
    path, model, curve = folder / f"{top}-{method}-{seed}", None, None
    for level in LEVELS[: LEVELS.index(top) + 1]:
        envs = vector(method, level)
        if model is None:
            model, curve = model_of(method, envs, seed), Curve(path.with_suffix(".csv"))
        else:
            model.set_env(envs)
        model.learn(steps, callback=curve, reset_num_timesteps=False)
        envs.close()
    save(model, path, steps)


class Policy:
    """What a learner has learned, for stage.bench."""

    def __init__(self, method: str, path: Path):
        self.method = method
        torch.manual_seed(0)
        self.model: Any = (MaskablePPO if method == "ppo" else MaskedDQN).load(path, device="cpu")

    def __call__(self, observation: np.ndarray, info: Any) -> int:
        mask = np.asarray(info["action_mask"])
        if self.method == "ppo":
            return int(self.model.predict(observation, deterministic=False, action_masks=mask > 0)[0])
        return int(self.model.predict(np.concatenate([observation, mask.astype(np.float32)]), deterministic=True)[0])


def submit(path: Path, splits: list[str], tasks: list[str], folder: Path) -> None:
    torch.set_num_threads(1)
    _, method, run = path.stem.split("-")
    folder.mkdir(parents=True, exist_ok=True)
    for task in tasks:
        for split in splits:
            entry = bench.play(
                Policy(method, path), task, split, name=f"{method}-masked", run=int(run), cost=cost_of(path)
            )
            bench.submit(entry, folder / f"{task}-{split}-{method}-{run}.bench", overwrite=True)
            print(f"{task} {split} {method} {run}: success {entry.scores['success'].mean():.0%}", flush=True)


if __name__ == "__main__":
    parser = parser_of(__doc__, ("ppo", "dqn"), STEPS, learn, submit, TASKS, LEVELS)
    args = parser.parse_args()
    args.run(args)
