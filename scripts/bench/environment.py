"""Benchmark of one environment, compared with a plain Gymnasium MujocoEnv on the same MJCF and with the same frame skip.

The overhead of a step is its time minus the time of its physics, which is measured as the same number of steps of the stage, or
of mj_step alone, in one call.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv

import stage.envs  # noqa: F401 registers the ids
from bench.figures import Figure, Run
from bench.machines import BareModel, find_model_path, make_moving_stage
from bench.timing import measure_alternately

TITLE = "One environment beside gymnasium's MujocoEnv (RegisterBus, an action that waits)"
SKIPS = (1, 4, 40)  # physics steps an action
DT = 2.5e-4  # s, of the shipped models
WAIT = np.array([2, 0, 0, 0])  # an action


class BaselineEnv(MujocoEnv):
    """Baseline environment of Gymnasium: torques as actions, positions and velocities, a reward, an info."""

    def __init__(self, model: str, frame_skip: int):
        super().__init__(model, frame_skip, None)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (self.model.nq + self.model.nv,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.model.nu,), np.float32)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, float]]:
        self.do_simulation(action, self.frame_skip)
        observation = np.concatenate([self.data.qpos, self.data.qvel])
        error = float(np.linalg.norm(self.data.qpos))
        return observation, -error, False, False, {"error": error}

    def reset_model(self) -> np.ndarray:
        self.set_state(self.init_qpos, self.init_qvel)
        return np.concatenate([self.data.qpos, self.data.qvel])


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    if importlib.util.find_spec("imageio") is None:
        print("    left out: gymnasium's MujocoEnv needs imageio; pip install -e '.[bench]'")
        return
    moving, bare = make_moving_stage(visuals=False), BareModel(make_moving_stage())
    start = moving.snapshot()
    for k in SKIPS:
        n = run.choose(4000, 800) // (k + 7)  # actions in a turn
        works = {
            "ours": make_own_work(k, n, start),
            "physics": (lambda: moving.restore(start), lambda n=n, k=k: moving.step(n * k)),
            "plain": make_baseline(k, n, bare),
            "bare": (bare.reset, lambda n=n, k=k: bare.step(n * k)),
        }
        t = {
            name: seconds / n * 1e6
            for name, seconds in measure_alternately(works, run.rounds, run.choose(25, 7)).items()
        }
        over, baseline_overhead = t["ours"] - t["physics"], t["plain"] - t["bare"]
        yield Figure.of(
            f"environment.overhead_{k}",
            f"overhead / MujocoEnv's, {k} step{'s' if k > 1 else ''} an action",
            "ratio",
            over / baseline_overhead,
        )
        yield Figure.of(f"environment.ours_{k}", "  ours", "us", over)
        yield Figure.of(f"environment.plain_{k}", "  MujocoEnv's", "us", baseline_overhead)
        yield Figure.of(f"environment.time_{k}", "  whole step / MujocoEnv's", "ratio", t["ours"] / t["plain"])


def make_own_work(k: int, n: int, start: Any) -> tuple[Callable[[], None], Callable[[], None]]:
    """Make a work of RegisterBus, whose stage is put in the middle of a move.

    Args:
        k: Physics steps of an action.
        n: Number of actions of a call.
        start: Snapshot in the middle of a move.

    Returns:
        Preparation and work.
    """
    env = gymnasium.make(
        "stage/RegisterBus-v0", waits=(k * DT,), time_limit=1e6, cycles=10**9, disable_env_checker=True
    ).unwrapped

    def prepare() -> None:
        env.reset(seed=0)
        env.stage.restore(start)

    def work() -> None:
        for _ in range(n):
            env.step(WAIT)

    return prepare, work


def make_baseline(k: int, n: int, bare: BareModel) -> tuple[Callable[[], None], Callable[[], None]]:
    """Make a work of the plain environment, under the mean torques of the same move.

    Args:
        k: Physics steps of an action.
        n: Number of actions of a call.
        bare: Model with the mean torques.

    Returns:
        Preparation and work.
    """
    env = BaselineEnv(find_model_path(), k)
    torque = bare.torque.astype(np.float32)

    def work() -> None:
        for _ in range(n):
            env.step(torque)

    return lambda: env.set_state(bare.began, bare.velocity), work
