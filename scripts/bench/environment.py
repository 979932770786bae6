"""Benchmark of one environment, compared with a plain Gymnasium MujocoEnv on the same MJCF and with the same frame skip.

The overhead of a step is its time minus the time of its physics, which is measured as the same number of steps of the stage, or
of mj_step alone, in one call. Each time is that of the fastest turn of a round.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv

import stage.envs  # noqa: F401 registers the ids
from bench.figures import Figure, Run
from bench.machines import BareModel, find_model_path, make_moving_stage
from bench.timing import measure_alternately

TITLE = "One environment beside gymnasium's MujocoEnv (RegisterBus, an action that waits)"
SKIPS = (1, 4, 40)  # physics steps an action
DT = 2.5e-4  # s, of the shipped models
WAIT = np.array([2, 0, 0, 0])  # an action


class BaselineEnv(InvertedPendulumEnv):
    """Step of Gymnasium's InvertedPendulum-v5, its shortest one on MuJoCo, with the model of a stage."""

    metadata = {key: value for key, value in InvertedPendulumEnv.metadata.items() if key != "render_fps"}  # noqa: RUF012

    def __init__(self, model: str, frame_skip: int):
        super().__init__(model, frame_skip)


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    if importlib.util.find_spec("imageio") is None:
        print("    left out: gymnasium's MujocoEnv needs imageio; pip install -e '.[bench]'")
        return
    moving, bare = make_moving_stage(visuals=False), BareModel(make_moving_stage())
    start = moving.snapshot()
    for k in SKIPS:
        n = 400 // (k + 7)  # actions in a turn, short enough that some turns are not interrupted
        works = {
            "ours": make_own_work(k, n, start),
            "physics": (lambda: moving.restore(start), lambda n=n, k=k: moving.step(n * k)),
            **make_baseline(k, n, bare),
        }
        t = {
            name: seconds / n * 1e6
            for name, seconds in measure_alternately(works, run.rounds, run.choose(200, 50), np.min).items()
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


def make_baseline(k: int, n: int, bare: BareModel) -> dict[str, tuple[Callable[[], None], Callable[[], None]]]:
    """Make the works of the plain environment and of its physics alone, under the mean torques of the same move.

    Args:
        k: Physics steps of an action.
        n: Number of actions of a call.
        bare: Model with the mean torques.

    Returns:
        Preparation and work of "plain", the environment, and of "bare", `mj_step` of its model.
    """
    env = BaselineEnv(find_model_path(), k)
    torque = bare.torque.astype(np.float32)

    def prepare() -> None:
        env.set_state(bare.began, bare.velocity)
        env.data.ctrl[:] = torque

    def work() -> None:
        for _ in range(n):
            env.step(torque)

    return {"plain": (prepare, work), "bare": (prepare, lambda: mujoco.mj_step(env.model, env.data, n * k))}
