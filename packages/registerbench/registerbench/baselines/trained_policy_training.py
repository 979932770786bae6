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
FIRST = (0.2, 0.9, 0.1, -0.1)  # first constants of start, drive, up and down, all a little slower than the formula


def name_features(observation: np.ndarray, names: list[str]) -> dict[str, Any]:
    """Return one observation by names, as a tool gives it to a player.

    Args:
        observation: Features of one machine.
        names: Names of the features; several of one name become a list.
    """
    values: dict[str, Any] = {}
    for name, value in zip(names, observation.tolist(), strict=True):
        values.setdefault(name, []).append(value)
    return {name: v[0] if len(v) == 1 else v for name, v in values.items()}


def compute_returns(envs: Any, kind: str, tables: np.ndarray, seed: int) -> np.ndarray:
    """Compute the return of each table: the mean over one episode on each of its machines.

    Args:
        envs: Vector environment.
        kind: Name of the task.
        tables: Weights, (tables, ...).
        seed: Seed of the first machine.

    Returns:
        Mean returns, (tables,).
    """
    tables = np.repeat(tables, EACH, axis=0)
    names, total = [e.name for e in envs.observation_features], np.zeros(MACHINES)
    observation, _ = envs.reset(seed=seed)
    while True:
        actions = [
            compute_action(w, compute_features(kind, name_features(row, names)))
            for w, row in zip(tables, observation, strict=True)
        ]
        observation, rewards, terminated, truncated, _ = envs.step(np.array(actions, np.float32))
        total += rewards
        if (terminated | truncated).all():
            return total.reshape(TABLES, EACH).mean(axis=1)


def train_table(kind: str, generations: int) -> np.ndarray:
    """Train the table of a task.

    Args:
        kind: Name of the task.
        generations: Number of generations.

    Returns:
        Mean of the tables after the last generation, (actions, features + 1).
    """
    card = CARDS[kind]
    vector: Any = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "Disabled"}
    envs = gymnasium.make_vec(card.id, MACHINES, **vector, **card.settings, split="train", truth="info").unwrapped
    rng = np.random.default_rng(0)
    middle = np.zeros((4, len(FEATURES[kind]) + 1))
    middle[:, -1] = FIRST
    spread = np.full(middle.shape, 0.25)
    for g in range(generations):
        tables = rng.normal(middle, spread, (TABLES, *middle.shape))
        tables[0] = middle
        reached = compute_returns(envs, kind, tables, 1000 + 10_000 * g)
        best = tables[np.argsort(reached)[-ELITE:]]
        middle, spread = best.mean(0), best.std(0) + 0.01
        print(f"{kind}, generation {g}: mean {reached.mean():.3f}, middle {reached[0]:.3f}", flush=True)
    envs.close()
    return middle


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generations", type=int, default=12)
    parser.add_argument("-o", "--output", default="trained.json")
    args = parser.parse_args()
    tables = {kind: np.round(train_table(kind, args.generations), 4).tolist() for kind in FEATURES}
    Path(args.output).write_text(json.dumps(tables, indent=1) + "\n")


if __name__ == "__main__":
    main()
