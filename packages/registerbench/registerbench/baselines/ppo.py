"""PPO by Stable-Baselines3: a policy of choices, improved a batch of moves at a time.

python -m registerbench.baselines.ppo --budget 1024 --seed 0
python -m registerbench.baselines.ppo --space registers

Its mean begins in the middle, which of the knobs is the data sheet's answer. Needs stable-baselines3 (extra `rl`).
"""

from __future__ import annotations

from stable_baselines3 import PPO

from registerbench.baselines.common import Moves, run
from registerbench.baselines.vec_env import MovesVecEnv

BATCH = 32  # moves between two improvements


def search(moves: Moves, seed: int = 0) -> None:
    """Spend the budget."""
    model = PPO(
        "MlpPolicy",
        MovesVecEnv(moves),
        n_steps=max(BATCH // moves.lanes, 1),
        batch_size=BATCH,
        n_epochs=10,
        learning_rate=3e-3,
        clip_range=0.3,
        policy_kwargs={"log_std_init": -1.5, "net_arch": [32]},
        seed=seed,
        device="cpu",
    )
    model.learn(moves.left)


if __name__ == "__main__":
    run(__doc__, search)
