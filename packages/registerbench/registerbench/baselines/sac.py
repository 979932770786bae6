"""SAC by Stable-Baselines3: learns what each choice is worth from all moves made so far, and chooses where it is most.

python -m registerbench.baselines.sac --budget 1024 --seed 0
python -m registerbench.baselines.sac --space registers

Its mean begins in the middle, which of the knobs is the data sheet's answer. Needs stable-baselines3 (extra `rl`).
"""

from __future__ import annotations

import torch
from stable_baselines3 import SAC

from registerbench.baselines.common import Moves, run
from registerbench.baselines.vec_env import MovesVecEnv

SPREAD = -1.5  # logarithm of the first choices' standard deviation


def search(moves: Moves, seed: int = 0) -> None:
    """Spend the budget."""
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
    torch.nn.init.constant_(model.actor.log_std.bias, SPREAD)
    model.learn(moves.left)


if __name__ == "__main__":
    run(__doc__, search)
