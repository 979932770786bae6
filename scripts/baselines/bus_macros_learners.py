"""Learners from scratch on `stage/BusMacros-v1`: DQN and PPO, both with the action mask.

python scripts/baselines/bus_macros_learners.py learn dqn --seed 0 --level axes -o runs
python scripts/baselines/bus_macros_learners.py evaluate runs/target-dqn-0.zip runs/axes-dqn-0.zip
python scripts/baselines/bus_macros_learners.py submit runs/target-dqn-0.zip --tasks bus-target -o entries

Both see axes by their role (bus_macros_turned.py): what was learned of one can be done with each.

dqn   DQN of Stable-Baselines3 with returns of five macros; the mask is part of what the network sees, and takes masked actions
      out of every maximum. It explores anew at each level; what it has learned acts by the softmax of its values
ppo   MaskablePPO of sb3-contrib; for one axis it took some eight times as many macros

A curriculum up to --level: each of LEVELS for so many steps, with easier episodes mixed in. Learning has settings of its own for
what the task lets one choose: `discount` is the learner's (so that progress changes no optimum), and a macro costs MACRO, that
dawdling shows; tests have the task's own. `learn` writes for each level the policy and the curve so far, a CSV with a row a batch.
`evaluate` plays the test episodes of a policy's level, by the ways that the targets lie. `submit` plays those of the bench and
packs them, see docs/benchmark.md. Needs the extra `rl`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from bus_macros_turned import Eased, Turn, Turned
from learning import Curve, Noted, cost_of, parser_of, save
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

from stage import bench
from stage.bench.cards import FIRST
from stage.envs.sb3 import StageVecEnv

ID = "stage/BusMacros-v1"
TASKS = ("bus-target", "bus-axes", "bus")
LEVELS = {"target": 40_960, "axes": 98_304, "origin": 131_072}
"""Steps of each, of which so many times as many with PPO."""
LONGER = {"dqn": 1, "ppo": 8}
LANES = {"dqn": 32, "ppo": 64}
GAMMA, MACRO = 0.99, 0.03  # of learning
REPLAY = {"n_steps": 5, "gamma": GAMMA, "handle_timeout_termination": False}
"""Returns of five macros; an episode that has used its macros has failed, and nothing comes after it."""
EXPLORES = 32_768  # steps of each level
AGAIN, LAST = 0.08, 0.03  # chance of a random macro where a later level begins, and at the end
TEMPERATURE = 0.05  # of a policy: macros that are nearly worth the same take turns, so none goes round in circles
EPISODES = 64  # of a test
EVERY = 4_096  # steps of a row of the curve


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
    """Explores among what is not masked, with chances from `first` down to LAST within EXPLORES steps after `begun`."""

    draw = np.random.default_rng(0)
    begun, first = 0, 1.0

    def _on_step(self) -> None:
        super()._on_step()
        done = (self.num_timesteps - self.begun) / EXPLORES
        self.exploration_rate = max(self.first + (LAST - self.first) * done, LAST)

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


def vector(method: str, level: str, seed: int) -> Any:
    """With the easier levels mixed in; and episodes where one of two axes need not move."""
    envs: Any = StageVecEnv(ID, LANES[method], threads=1, level=level, mixed=True, discount=GAMMA, macro_weight=MACRO)
    return Noted(Turned(Eased(envs, seed) if level == "axes" else envs, behind=method == "dqn"))


def model_of(method: str, envs: Any, seed: int) -> Any:
    nets: dict[str, Any] = {"net_arch": [128, 128]}
    if method == "ppo":
        return MaskablePPO(
            "MlpPolicy", envs, n_steps=64, batch_size=1024, n_epochs=6, learning_rate=7e-4, gamma=GAMMA, ent_coef=0.01,
            policy_kwargs=nets, seed=seed, device="cpu",
        )  # fmt: skip
    return MaskedDQN(
        MaskedPolicy, envs, buffer_size=300_000, learning_starts=4_000, batch_size=256, learning_rate=5e-4, gamma=GAMMA,
        replay_buffer_class=NStepReplayBuffer, replay_buffer_kwargs=REPLAY, train_freq=4,
        gradient_steps=LANES[method], target_update_interval=2_000, policy_kwargs=nets, seed=seed, device="cpu",
    )  # fmt: skip


def learn(method: str, seed: int, times: float, top: str, folder: Path) -> None:
    torch.set_num_threads(1)
    MaskedDQN.draw = np.random.default_rng(seed)
    model, curve, begun = None, Curve(folder / "curve.csv", EVERY), 0
    for level, steps in list(LEVELS.items())[: list(LEVELS).index(top) + 1]:
        path, envs = folder / f"{level}-{method}-{seed}", vector(method, level, seed)
        if model is None:
            model = model_of(method, envs, seed)
        else:
            model.set_env(envs)
            model.begun, model.first = begun, AGAIN
        curve.path, begun = path.with_suffix(".csv"), begun + int(steps * LONGER[method] * times)
        model.learn(begun - model.num_timesteps, callback=curve, reset_num_timesteps=False)
        envs.close()
        save(model, path, begun)


class Policy:
    """What a learner has learned, for stage.bench."""

    def __init__(self, method: str, path: Path):
        self.method = method
        self.turn: Turn | None = None
        self.draw = np.random.default_rng(0)
        torch.manual_seed(0)
        self.model: Any = (MaskablePPO if method == "ppo" else MaskedDQN).load(path, device="cpu")

    def reset(self, around: Any) -> None:
        """around.entries has the names of what is seen."""
        self.turn = Turn(around.entries, self.model.action_space.n)

    def choose(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Macros, (n,)."""
        axis = self.turn.axis(observations)
        seen, masks = self.turn.seen(observations, axis), self.turn.masks(masks, axis)
        if self.method == "ppo":
            chosen = self.model.predict(seen, deterministic=False, action_masks=masks > 0)[0]
        else:
            with torch.no_grad():
                worth = self.model.q_net(torch.as_tensor(np.concatenate([seen, masks], axis=1, dtype=np.float32)))
            chosen = (worth.numpy() / TEMPERATURE + self.draw.gumbel(size=worth.shape)).argmax(axis=1)
        return self.turn.back(chosen, axis)

    def __call__(self, observation: np.ndarray, info: Any) -> int:
        return int(self.choose(observation[None], np.asarray(info["action_mask"])[None])[0])


def evaluate(path: Path) -> None:
    """Success on the test episodes of the policy's level, by the signs of the targets of x and y."""
    torch.set_num_threads(1)
    level, method, run = path.stem.split("-")
    policy, envs = Policy(method, path), StageVecEnv(ID, EPISODES, threads=1, level=level)
    policy.turn = Turn([e.name for e in envs.envs.entries], envs.action_space.n)
    envs.seed(FIRST)
    seen = envs.reset()
    states = envs.envs._task.axis_states
    ways = [
        "".join("-+"[int(t > 0)] for t in row[: 1 if level == "target" else 2]) for row in states["target"].tolist()
    ]
    won, moves, left = np.zeros(EPISODES, bool), np.zeros(EPISODES, int), np.ones(EPISODES, bool)
    while left.any():
        seen, _, ends, infos = envs.step(policy.choose(seen, envs.envs.action_masks()))
        for k in np.flatnonzero(ends & left):
            won[k], moves[k] = infos[k]["score"]["success"], infos[k]["score"]["moves"]
        left &= ~ends
    envs.close()
    of = {way: won[[w == way for w in ways]] for way in sorted(set(ways))}
    each = ", ".join(f"{way} {found.sum()} of {len(found)}" for way, found in of.items())
    spent = cost_of(path)
    print(
        f"| {level} | {method} | {run} | {spent['moves']:.0f} | {spent['processor_s']:.0f} | {won.sum()} of {EPISODES} | {each} "
        f"| {moves[won].mean() if won.any() else np.nan:.1f} |",
        flush=True,
    )


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
    parser = parser_of(__doc__, ("dqn", "ppo"), 1.0, learn, submit, TASKS, tuple(LEVELS), evaluate)
    args = parser.parse_args()
    args.run(args)
