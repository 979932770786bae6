"""PPO and SAC on `stage/OneShotTuning-v1`, by Stable-Baselines3: one move an episode, on a machine whose payload is declared.

python -m registerbench.baselines.one_shot_learners learn sac --seed 0 -o runs
python -m registerbench.baselines.one_shot_learners submit runs/one-shot_sac-0.zip -o entries

Both learn rates and ramps for each distance and payload from scratch. `submit` plays the mean action of the final policy. Training
has cheaper settings than the tests, as in parametric_policy_learners.py. Nothing was chosen by test episodes. `learn` writes the
policy and its curve, a CSV file with a row for each BATCH moves. Needs the extra `rl`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC

from registerbench.baselines import exit_on_interrupt
from registerbench.baselines.bench_entries import write_entry
from registerbench.baselines.learner_support import (
    EpisodeRecorder,
    LearningCurveWriter,
    make_parser,
    read_cost,
    read_training,
    save_policy,
)
from registerbench.baselines.training_envs import CHEAPER_SETTINGS
from registerbench.benchmark_tasks import OPEN_ROUND
from stage.envs.sb3 import StageVecEnv

ID, TASK = "stage/OneShotTuning-v1", "one-shot"
KINDS: dict[str, Any] = {"ppo": PPO, "sac": SAC}
STEPS, PARALLEL_ENVS, BATCH = 4_096, 16, 512
INITIAL_LOG_STD = -0.7  # logarithm of the standard deviation of the first choices
SETTINGS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": BATCH // PARALLEL_ENVS,
        "batch_size": 128,
        "n_epochs": 10,
        "policy_kwargs": {"log_std_init": INITIAL_LOG_STD},
    },
    "sac": {
        "learning_starts": BATCH,
        "train_freq": 1,
        "gradient_steps": PARALLEL_ENVS // 2,
        "batch_size": 128,
        "ent_coef": 0.01,
    },
}


def learn(method: str, seed: int, steps: int, folder: Path) -> None:
    """Train a policy from scratch, and write it and its learning curve.

    Args:
        method: "ppo" or "sac".
        seed: Seed of the run.
        steps: Number of moves.
        folder: Folder of the files.
    """
    torch.set_num_threads(1)
    envs = EpisodeRecorder(StageVecEnv(ID, PARALLEL_ENVS, threads=1, **CHEAPER_SETTINGS[TASK]))
    settings = {**SETTINGS[method], "learning_rate": 1e-3, "seed": seed, "device": "cpu"}
    settings["policy_kwargs"] = {"net_arch": [64, 64], **settings.get("policy_kwargs", {})}
    model = KINDS[method]("MlpPolicy", envs, **settings)
    if method == "sac":
        torch.nn.init.constant_(model.actor.log_std.bias, INITIAL_LOG_STD)
    path = folder / f"{TASK}_{method}-{seed}"
    model.learn(steps, callback=LearningCurveWriter(path.with_suffix(".csv"), BATCH))
    envs.close()
    save_policy(model, path, steps)


class OneShotPolicy:
    """Learned policy on OneShotTuning, for `registerbench.play`.

    Args:
        method: "ppo" or "sac".
        path: File of the model.
    """

    def __init__(self, method: str, path: Path):
        self.model = KINDS[method].load(path, device="cpu")

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        return np.clip(self.model.predict(observation, deterministic=True)[0], -1, 1)


def submit(path: Path, splits: list[str], tasks: list[str], folder: Path, round_: str = OPEN_ROUND) -> None:
    """Play the test episodes of each split with a policy, and write the entries.

    Args:
        path: Policy that `learn` wrote.
        splits: Names of the splits.
        tasks: Not used: there is one task.
        folder: Folder of the entries.
        round_: Round of the benchmark.
    """
    torch.set_num_threads(1)
    method, run = path.stem.partition("_")[2].split("-")
    settings = {"name": method, "cost": read_cost(path), "training": read_training(path, "one_shot_learners", method)}
    for split in splits:
        write_entry(OneShotPolicy(method, path), TASK, split, folder, method, int(run), round_=round_, **settings)


if __name__ == "__main__":
    parser = make_parser(__doc__, tuple(KINDS), STEPS, learn, submit, (TASK,))
    args = parser.parse_args()
    with exit_on_interrupt(
        "the curve so far and earlier files are saved; the same command learns the whole run again."
    ):
        args.run(args)
