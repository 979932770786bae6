"""What `early_ends` of RegisterTuning is worth: the same moves with it and without, by turns, on the same threads."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

import stage.envs  # noqa: F401 registers the ids
from bench.timing import timed
from stage.tune.formula import compute_registers

ID = "stage/RegisterTuning-v0"
STAGES, THREADS, SEED = 16, 2, 240
NOISE = 0.1  # of an action from -1 to 1, standard deviation
PLAYERS = {"random": None, f"formula, noise {NOISE}": NOISE, "formula": 0.0}


def vector(early_ends: bool, threads: int | None, **settings: Any) -> Any:
    kind = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "NextStep", "threads": threads or THREADS}
    return gymnasium.make_vec(ID, num_envs=STAGES, early_ends=early_ends, **kind, **settings)


def moves(envs: Any, noise: float | None) -> tuple[list[np.ndarray], float]:
    """The actions of an episode of each stage, and the share of the moves that keep step and end; noise: None for random ones."""
    task, rng = envs.unwrapped._task, np.random.default_rng(SEED)
    envs.action_space.seed(SEED)
    envs.reset(seed=SEED)
    actions, good = [], []
    for _ in range(task.config.moves):
        if noise is None:
            action = envs.action_space.sample()
        else:
            axes = [stage.axes[task.config.axis] for stage in task.stages]
            rows = [
                compute_registers(a, int(d), s_curve=task.config.s_curve)
                for a, d in zip(axes, task.distance, strict=True)
            ]
            action = np.array([task.registers.to_action(row) for row in rows])
            action = np.clip(action + noise * rng.standard_normal(action.shape), -1, 1).astype(np.float32)
        parts = envs.step(action)[4]["reward_parts"]
        actions.append(action)
        good.append((parts["lost"] == 0) & (parts["limit"] == 0))
    return actions, float(np.mean(good))


def measure(rounds: int, threads: int | None, clock: Any, settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """By player: share of good moves, moves a second without and with early ends, and their ratio, a value a round."""
    both = [vector(early, threads, **settings) for early in (False, True)]
    played = {name: moves(both[0], noise) for name, noise in PLAYERS.items()}
    seconds: dict[str, list[list[float]]] = {name: [[], []] for name in PLAYERS}
    for turn in range(rounds):
        for name, (actions, _) in played.items():
            for k in (turn % 2, 1 - turn % 2):
                both[k].reset(seed=SEED)
                seconds[name][k].append(timed(lambda e=both[k], a=actions: [e.step(one) for one in a], clock))
    for envs in both:
        envs.close()
    found = {}
    for name, (actions, good) in played.items():
        was, now = np.array(seconds[name])
        n = STAGES * len(actions)
        found[name] = {"good": good, "today": n / was, "early ends": n / now, "times": was / now}
    return found
