"""Training of the shipped player "trained" by the cross-entropy method: tables of weights from an observation to an action.

python -m registerbench.baselines.trained_policy_training --generations 12 -o trained.json
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import stage.envs  # noqa: F401 (registers the environments)
from registerbench.arena.players.trained_policy import FEATURES, compute_action, compute_features
from registerbench.benchmark_tasks import CARDS

TABLES, EACH, ELITE = 24, 4, 6
MACHINES = TABLES * EACH  # each table plays EACH machines
FIRST_CONSTANTS = (
    0.2,
    0.9,
    0.1,
    -0.1,
)  # first constants of start, drive, up and down, all a little slower than the formula


def map_features_by_name(observation: np.ndarray, names: list[str]) -> dict[str, Any]:
    """Return the observation of one machine by name, as a tool returns it to a player.

    Args:
        observation: Features of the machine, (features,).
        names: Names of the features; several features of one name become a list.
    """
    values: dict[str, Any] = {}
    for name, value in zip(names, observation.tolist(), strict=True):
        values.setdefault(name, []).append(value)
    return {name: v[0] if len(v) == 1 else v for name, v in values.items()}


def compute_returns(envs: Any, task: str, weights: np.ndarray, seed: int) -> np.ndarray:
    """Compute the return of each candidate policy: the mean over one episode on each of its EACH machines.

    Args:
        envs: Vector environment of MACHINES machines.
        task: Name of the task.
        weights: Weights of the candidates, (TABLES, actions, features + 1).
        seed: Seed of the first machine.

    Returns:
        Mean returns, (TABLES,).
    """
    weights = np.repeat(weights, EACH, axis=0)
    names, total = [e.name for e in envs.observation_features], np.zeros(MACHINES)
    observation, _ = envs.reset(seed=seed)
    while True:
        actions = [
            compute_action(w, compute_features(task, map_features_by_name(row, names)))
            for w, row in zip(weights, observation, strict=True)
        ]
        observation, rewards, terminated, truncated, _ = envs.step(np.array(actions, np.float32))
        total += rewards
        if (terminated | truncated).all():
            return total.reshape(TABLES, EACH).mean(axis=1)


def train_weights(task: str, generations: int) -> np.ndarray:
    """Train the weights of the policy for a task by the cross-entropy method.

    Args:
        task: Name of the task.
        generations: Number of generations.

    Returns:
        Mean of the best weights of the last generation, (actions, features + 1).
    """
    card = CARDS[task]
    vector: Any = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "Disabled"}
    envs = gymnasium.make_vec(card.id, MACHINES, **vector, **card.settings, split="train", truth="info").unwrapped
    rng = np.random.default_rng(0)
    middle = np.zeros((4, len(FEATURES[task]) + 1))
    middle[:, -1] = FIRST_CONSTANTS
    spread = np.full(middle.shape, 0.25)
    for g in range(generations):
        tables = rng.normal(middle, spread, (TABLES, *middle.shape))
        tables[0] = middle
        reached = compute_returns(envs, task, tables, 1000 + 10_000 * g)
        best = tables[np.argsort(reached)[-ELITE:]]
        middle, spread = best.mean(0), best.std(0) + 0.01
        print(f"{task}, generation {g}: mean {reached.mean():.3f}, middle {reached[0]:.3f}", flush=True)
    envs.close()
    return middle


def main() -> None:
    """Train the policies of all tasks, and write them to a JSON file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generations", type=int, default=12)
    parser.add_argument("-o", "--output", default="trained.json")
    args = parser.parse_args()
    tables = {kind: np.round(train_weights(kind, args.generations), 4).tolist() for kind in FEATURES}
    Path(args.output).write_text(json.dumps(tables, indent=1) + "\n")


if __name__ == "__main__":
    main()
