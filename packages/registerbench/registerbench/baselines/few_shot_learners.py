"""PPO on `stage/FewShotTuning-v1` with and without memory: the worth of memory to a learner from scratch.

python -m registerbench.baselines.few_shot_learners learn none --seed 0 -o runs
python -m registerbench.baselines.few_shot_learners learn recurrent --seed 0 -o runs
python -m registerbench.baselines.few_shot_learners submit runs/recurrent-0.zip -o entries --splits train weak

none       PPO that observes only the distance and the number of attempts left, so it knows nothing of earlier attempts
all        PPO that observes every attempt of the episode (memory="all")
recurrent  recurrent PPO (an LSTM) that observes only the last attempt (memory="last") and remembers the others itself

`learn` writes the policy and its curve, a CSV with a row a batch. `submit` plays the test episodes of splits and packs them, see
docs/benchmark.md. Needs the extra `rl`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper

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
from registerbench.benchmark_tasks import OPEN_ROUND
from stage.envs.sb3 import StageVecEnv

ID, TASK = "stage/FewShotTuning-v1", "few-shot"
MEMORY_BY_METHOD = {"none": "last", "all": "all", "recurrent": "last"}
"""Setting `memory` of the environment by method."""
VISIBLE_FEATURES = {"none": ("distance", "left")}
"""Features that a method observes, if not all."""
STEPS, PARALLEL_ENVS, BATCH = 16_384, 16, 512
PROOFS = 2  # in training, to make it cheaper; tests use the task's own number
SETTINGS: dict[str, Any] = {
    "n_steps": BATCH // PARALLEL_ENVS, "batch_size": 128, "n_epochs": 10, "learning_rate": 1e-3, "gamma": 1.0, "gae_lambda": 0.95,
    "device": "cpu",
}  # fmt: skip
NETS: dict[str, dict[str, Any]] = {
    "none": {"net_arch": [64, 64], "log_std_init": -0.7},
    "all": {"net_arch": [64, 64], "log_std_init": -0.7},
    "recurrent": {"net_arch": [64], "log_std_init": -0.7, "lstm_hidden_size": 64},
}


def find_visible_columns(method: str, names: Any) -> np.ndarray:
    """Return the indices of the features that a method observes.

    Args:
        method: Name of the method.
        names: Names of all features of an observation.
    """
    return np.array([k for k, name in enumerate(names) if name in VISIBLE_FEATURES.get(method, names)])


class SelectedColumnsVecEnv(VecEnvWrapper):
    """Wrapper that keeps only some columns of the observations.

    Args:
        envs: The environments.
        which: Indices of the columns.
    """

    def __init__(self, envs: Any, which: np.ndarray):
        super().__init__(envs, gymnasium.spaces.Box(-1.0, 1.0, (len(which),), np.float32))
        self.which = which

    def reset(self) -> Any:
        observation: Any = self.venv.reset()
        return observation[:, self.which]

    def step_wait(self) -> Any:
        observation, rewards, ends, infos = self.venv.step_wait()
        for k in np.flatnonzero(ends):
            infos[k]["terminal_observation"] = infos[k]["terminal_observation"][self.which]
        return observation[:, self.which], rewards, ends, infos  # type: ignore[index]


def learn(method: str, seed: int, steps: int, folder: Path) -> None:
    """Train a policy from scratch, and write it and its learning curve.

    Args:
        method: Name of the method.
        seed: Seed of the run.
        steps: Number of attempts.
        folder: Folder of the files.
    """
    torch.set_num_threads(1)
    raw = StageVecEnv(ID, PARALLEL_ENVS, threads=1, memory=MEMORY_BY_METHOD[method], proofs=PROOFS)
    envs = EpisodeRecorder(
        SelectedColumnsVecEnv(raw, find_visible_columns(method, [e.name for e in raw.envs.observation_features]))
    )
    kind: Any = RecurrentPPO if method == "recurrent" else PPO
    policy = "MlpLstmPolicy" if method == "recurrent" else "MlpPolicy"
    model = kind(policy, envs, seed=seed, policy_kwargs=NETS[method], **SETTINGS)
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
        self.method = method
        kind: Any = RecurrentPPO if method == "recurrent" else PPO
        self.model = kind.load(path, device="cpu")

    def reset(self, policy_context: Any) -> None:
        self.which, self.state = find_visible_columns(self.method, policy_context.feature_names), None

    def __call__(self, observation: np.ndarray, info: Any) -> np.ndarray:
        begins = np.array([self.state is None])
        action, self.state = self.model.predict(observation[self.which], self.state, begins, deterministic=True)
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
    method, run = path.stem.split("-")
    settings = {
        "settings": {"memory": MEMORY_BY_METHOD[method]},
        "name": f"ppo, memory {method}",
        "cost": read_cost(path),
        "training": read_training(path, "few_shot_learners", method),
        "round_": round_,
    }
    for split in splits:
        write_entry(FewShotPolicy(method, path), TASK, split, folder, f"ppo-{method}", int(run), **settings)


if __name__ == "__main__":
    parser = make_parser(__doc__, tuple(MEMORY_BY_METHOD), STEPS, learn, submit, (TASK,))
    args = parser.parse_args()
    with exit_on_interrupt(
        "the curve so far and earlier files are saved; the same command learns the whole run again."
    ):
        args.run(args)
