"""Double DQN with an action mask for bus_macros_learners.py: a masked action is never tried and never the best one."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

RETURN_STEPS = 5  # macros in an n-step return
EXPLORATION_STEPS = 32_768  # in each level, within which the exploration rate falls
LEVEL_START_RATE, FINAL_RATE = 0.3, 0.03  # chance of a random macro at the start of a later level, and at the end


class MaskedNetwork(QNetwork):
    """Network that gives masked actions a value that is never the highest. The observation ends with the mask."""

    def forward(self, obs: Any) -> torch.Tensor:
        values = super().forward(obs)
        return torch.where(obs[:, -values.shape[1] :] > 0.5, values, torch.full_like(values, -1e6))


class MaskedPolicy(DQNPolicy):
    """DQN policy whose network gives masked actions, which have no effect now, a value that is never the highest."""

    def make_q_net(self) -> QNetwork:
        args = self._update_features_extractor(self.net_args, features_extractor=None)
        return MaskedNetwork(**args).to(self.device)


class MaskedDQN(DQN):
    """Double DQN that explores only among actions that the mask allows.

    The exploration rate falls from `first` to FINAL_RATE within EXPLORATION_STEPS steps after `level_start`. Double: the
    network chooses the best next action, and the target network estimates its value, which reduces overestimation.
    """

    draw = np.random.default_rng(0)
    level_start, first = 0, 1.0

    def restart_exploration(self) -> None:
        """Raise the exploration rate at the start of another level."""
        self.level_start, self.first = self.num_timesteps, LEVEL_START_RATE

    def train(self, gradient_steps: int, batch_size: int = 256) -> None:
        for _ in range(gradient_steps):
            some: Any = self.replay_buffer.sample(batch_size)  # type: ignore[union-attr]
            with torch.no_grad():
                best = self.q_net(some.next_observations).argmax(dim=1, keepdim=True)
                later = self.q_net_target(some.next_observations).gather(1, best)
                aim = some.rewards + (1 - some.dones) * some.discounts * later
            worth = self.q_net(some.observations).gather(1, some.actions.long())
            self.policy.optimizer.zero_grad()
            torch.nn.functional.smooth_l1_loss(worth, aim).backward()
            torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
            self.policy.optimizer.step()
        self._n_updates += gradient_steps

    def _on_step(self) -> None:
        super()._on_step()
        progress = (self.num_timesteps - self.level_start) / EXPLORATION_STEPS
        self.exploration_rate = max(self.first + (FINAL_RATE - self.first) * progress, FINAL_RATE)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> Any:
        actions, state = super().predict(observation, state, episode_start, deterministic=True)
        if not deterministic:
            masks = np.atleast_2d(observation)[:, -self.action_space.n :] > 0.5  # type: ignore[attr-defined]
            for k in np.flatnonzero(self.draw.random(len(masks)) < self.exploration_rate):
                actions[k] = self.draw.choice(np.flatnonzero(masks[k]))
        return actions, state

    def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> Any:
        actions, _ = self.predict(self._last_obs, deterministic=False)
        return actions, actions


def make_dqn(envs: Any, gamma: float, seed: int) -> MaskedDQN:
    """Make an untrained DQN model for BusMacros.

    Args:
        envs: Environments whose observations end with the mask.
        gamma: Discount of a macro.
        seed: Seed of the network and of the exploration.
    """
    MaskedDQN.draw = np.random.default_rng(seed)
    replay = {"n_steps": RETURN_STEPS, "gamma": gamma, "handle_timeout_termination": False}  # a timeout is a failure
    return MaskedDQN(
        MaskedPolicy, envs, buffer_size=300_000, learning_starts=4_000, batch_size=256, learning_rate=5e-4, gamma=gamma,
        replay_buffer_class=NStepReplayBuffer, replay_buffer_kwargs=replay, train_freq=4, gradient_steps=envs.num_envs,
        target_update_interval=2_000, policy_kwargs={"net_arch": [128, 128]}, seed=seed, device="cpu",
    )  # fmt: skip
