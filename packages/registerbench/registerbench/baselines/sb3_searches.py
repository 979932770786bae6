"""Searches by the learners of Stable-Baselines3 (extra `rl`): a move is an episode of one step, an action is a choice.

python -m registerbench.baselines.sb3_searches ppo --budget 1024 --seed 0
python -m registerbench.baselines.sb3_searches sac --space registers

PPO improves a policy with each batch of moves; SAC learns the value of each choice from all moves so far. Their means begin in the
middle, which is the formula's answer in the space of knobs.
"""

from __future__ import annotations

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO, SAC

from registerbench.baselines.move_tuning import MoveTuning, run_command_line
from stage.envs.sb3 import VecEnvAdapter

torch.set_num_threads(1)  # the networks are small, and the stages need the processors

BATCH = 32  # moves between two improvements of PPO
INITIAL_LOG_STD = -1.5  # logarithm of the standard deviation of the first choices
WORST, SCALE = -1.0, 5.0
"""A learner's reward is SCALE x max(reward of the environment, WORST); moves that lost steps have WORST."""


class MovesVecEnv(VecEnvAdapter):
    """Vector environment of Stable-Baselines3 whose actions are choices of a MoveTuning.

    Rewards are between SCALE x WORST and 0. `close` leaves the environment of the MoveTuning open.
    """

    def __init__(self, moves: MoveTuning):
        self.moves = moves
        super().__init__(moves.env.unwrapped, gymnasium.spaces.Box(-1.0, 1.0, (moves.size,), np.float32))

    def reset(self) -> np.ndarray:
        return self.moves.observation

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        rewards = SCALE * np.maximum(np.nan_to_num(self.moves.measure_rewards(self._actions)), WORST)
        observation = self.moves.observation
        infos = [{"terminal_observation": row} for row in observation]
        return observation, rewards.astype(np.float32), np.ones(self.num_envs, bool), infos

    def close(self) -> None:
        pass


def search_by_ppo(moves: MoveTuning, seed: int = 0) -> None:
    """Spend the budget of moves on the choices of the learner PPO.

    Args:
        moves: Move that is tuned.
        seed: Seed of the learner.
    """
    model = PPO(
        "MlpPolicy",
        MovesVecEnv(moves),
        n_steps=max(BATCH // moves.lanes, 1),
        batch_size=BATCH,
        n_epochs=10,
        learning_rate=3e-3,
        clip_range=0.3,
        policy_kwargs={"log_std_init": INITIAL_LOG_STD, "net_arch": [32]},
        seed=seed,
        device="cpu",
    )
    model.learn(moves.moves_left)


def search_by_sac(moves: MoveTuning, seed: int = 0) -> None:
    """Spend the budget of moves on the choices of the learner SAC.

    Args:
        moves: Move that is tuned.
        seed: Seed of the learner.
    """
    model = SAC(
        "MlpPolicy",
        MovesVecEnv(moves),
        learning_starts=moves.lanes,
        train_freq=1,
        gradient_steps=moves.lanes,
        batch_size=128,
        learning_rate=1e-3,
        ent_coef=0.01,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )
    torch.nn.init.constant_(model.actor.log_std.bias, INITIAL_LOG_STD)
    model.learn(moves.moves_left)


if __name__ == "__main__":
    run_command_line(__doc__, {"ppo": search_by_ppo, "sac": search_by_sac})
