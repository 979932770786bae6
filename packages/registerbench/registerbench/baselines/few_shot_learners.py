"""PPO, recurrent PPO and SAC of Stable-Baselines3 on `stage/FewShotTuning-v1`, each from scratch.

python -m registerbench.baselines.few_shot_learners learn recurrent-ppo --seed 0 -o runs
python -m registerbench.baselines.few_shot_learners submit runs/recurrent-ppo-0.zip -o entries --splits train weak

ppo, sac        observe every attempt of the episode (memory="all")
recurrent-ppo   an LSTM observes only the last attempt (memory="last") and remembers the others itself

`learn` writes the policy and its curve, a CSV file with a row for each BATCH attempts. `submit` plays the test episodes of splits
with the mean action of the policy and packs them, see docs/benchmark.md. Nothing was chosen by test episodes. Needs the extra `rl`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import RecurrentPPO
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

ID, TASK = "stage/FewShotTuning-v1", "few-shot"
STEPS, PARALLEL_ENVS, BATCH = 4_096, 16, 512
PROOFS = 2  # in training, to make it cheaper; tests use the task's own number
INITIAL_LOG_STD = -0.7  # logarithm of the standard deviation of the first choices
ON_POLICY: dict[str, Any] = {
    "n_steps": BATCH // PARALLEL_ENVS,
    "batch_size": 128,
    "n_epochs": 10,
    "gae_lambda": 0.95,
}


@dataclass(frozen=True)
class Method:
    """Method of Stable-Baselines3 with its settings.

    Attributes:
        algorithm: Class of the algorithm.
        policy: Name of the policy class.
        memory: Setting `memory` of the environment.
        policy_kwargs: Arguments of the policy class.
        settings: Arguments of the algorithm.
    """

    algorithm: Any
    policy: str
    memory: str
    policy_kwargs: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=dict)


METHODS = {
    "ppo": Method(PPO, "MlpPolicy", "all", {"net_arch": [64, 64], "log_std_init": INITIAL_LOG_STD}, ON_POLICY),
    "recurrent-ppo": Method(
        RecurrentPPO,
        "MlpLstmPolicy",
        "last",
        {"net_arch": [64], "log_std_init": INITIAL_LOG_STD, "lstm_hidden_size": 64},
        ON_POLICY,
    ),
    "sac": Method(
        SAC,
        "MlpPolicy",
        "all",
        {"net_arch": [64, 64]},
        {"learning_starts": BATCH, "train_freq": 1, "gradient_steps": PARALLEL_ENVS // 2, "batch_size": 128, "ent_coef": 0.01},
    ),
}  # fmt: skip
"""Methods by their name."""


def learn(method: str, seed: int, steps: int, folder: Path) -> None:
    """Train a policy from scratch, and write it and its learning curve.

    Args:
        method: Name of the method.
        seed: Seed of the run.
        steps: Number of attempts.
        folder: Folder of the files.
    """
    torch.set_num_threads(1)
    selected, cheaper = METHODS[method], CHEAPER_SETTINGS[TASK]
    envs = EpisodeRecorder(StageVecEnv(ID, PARALLEL_ENVS, threads=1, memory=selected.memory, proofs=PROOFS, **cheaper))
    model = selected.algorithm(
        selected.policy,
        envs,
        seed=seed,
        policy_kwargs=selected.policy_kwargs,
        learning_rate=1e-3,
        gamma=1.0,
        device="cpu",
        **selected.settings,
    )
    if selected.algorithm is SAC:
        torch.nn.init.constant_(model.actor.log_std.bias, INITIAL_LOG_STD)
    path = folder / f"{method}-{seed}"
    model.learn(steps, callback=LearningCurveWriter(path.with_suffix(".csv"), BATCH))
    envs.close()
    save_policy(model, path, steps)


class FewShotPolicy:
    """Learned policy on FewShotTuning, for `registerbench.play`.

    Args:
        method: Name of the method.
        path: File of the model.
    """

    def __init__(self, method: str, path: Path):
        self.model = METHODS[method].algorithm.load(path, device="cpu")

    def reset(self, policy_context: Any) -> None:
        self.state = None

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        begins = np.array([self.state is None])
        action, self.state = self.model.predict(observation, self.state, begins, deterministic=True)
        return np.clip(action, -1, 1)


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
    method, _, run = path.stem.rpartition("-")
    settings = {
        "settings": {"memory": METHODS[method].memory},
        "name": method.replace("-", " "),
        "cost": read_cost(path),
        "training": read_training(path, "few_shot_learners", method),
        "round_": round_,
    }
    for split in splits:
        write_entry(FewShotPolicy(method, path), TASK, split, folder, method, int(run), **settings)


if __name__ == "__main__":
    parser = make_parser(__doc__, tuple(METHODS), STEPS, learn, submit, (TASK,))
    args = parser.parse_args()
    with exit_on_interrupt(
        "the curve so far and earlier files are saved; the same command learns the whole run again."
    ):
        args.run(args)
