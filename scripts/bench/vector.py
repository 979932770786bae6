"""Benchmark of many stages on threads, compared with mujoco.batch.Batch: a `Fleet` that plays waits, and the vector RegisterBus."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np

import stage.envs  # noqa: F401 registers the ids
from bench.figures import Figure, Run
from bench.machines import MujocoBatch, make_moving_stage
from bench.timing import measure_alternately
from stage import Fleet, Program

TITLE = "Vector stages beside mujoco.batch.Batch (64 stages in motion)"
STAGES = 64
STEPS = 40  # physics steps of a wait
DT = 2.5e-4  # s, of the shipped models
SETTINGS = {"waits": (STEPS * DT,), "time_limit": 1e6, "cycles": 10**9}
WAIT = 2  # kind of action


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    plays = run.choose(5, 2)  # waits in a turn
    works: dict[str, tuple[Callable, Callable]] = {}
    for threads in (1, 2):
        works[f"fleet_{threads}"] = make_playing_work(threads, plays)
        works[f"env_{threads}"] = make_acting_work(threads, plays)
        works[f"batch_{threads}"] = make_batch_work(threads, plays)
    t = measure_alternately(works, run.rounds, run.choose(9, 2))
    steps = STAGES * STEPS * plays
    yield Figure.of(
        "vector.batch_two", "Batch, two threads / one", "ratio", t["batch_1"] / t["batch_2"], "the machine's own"
    )
    for key, name in (("fleet", "Fleet"), ("env", "RegisterBus, vector")):
        yield Figure.of(f"vector.{key}_two", f"{name}, two threads / one", "ratio", t[f"{key}_1"] / t[f"{key}_2"])
        for threads, word in ((1, "one thread"), (2, "two threads")):
            ratio = t[f"batch_{threads}"] / t[f"{key}_{threads}"]
            yield Figure.of(f"vector.{key}_batch_{threads}", f"{name} / Batch, {word}", "ratio", ratio)
        yield Figure.of(f"vector.{key}_rate", f"{name}, two threads, physics steps", "1/s", steps / t[f"{key}_2"])


def make_playing_work(threads: int, plays: int) -> tuple[Callable[[], None], Callable[[], None]]:
    """Make a work of a fleet that plays waits.

    Args:
        threads: Number of threads.
        plays: Number of plays in a call.

    Returns:
        Preparation and work.
    """
    first = make_moving_stage(visuals=False)
    start = first.snapshot()
    fleet = Fleet([first, *(copy.deepcopy(first) for _ in range(STAGES - 1))], threads)
    programs = make_wait_programs(STAGES, STEPS)

    def prepare() -> None:
        for s in fleet.stages:
            s.restore(start)

    return prepare, lambda: repeat(plays, lambda: fleet.play(programs))


def make_acting_work(threads: int, plays: int) -> tuple[Callable[[], None], Callable[[], None]]:
    """Make a work of the vector environment, whose stages are put in the middle of a move.

    Args:
        threads: Number of threads.
        plays: Number of steps in a call.

    Returns:
        Preparation and work.
    """
    kind: dict[str, Any] = {"vectorization_mode": "vector_entry_point", "threads": threads}
    envs = gymnasium.make_vec("stage/RegisterBus-v0", num_envs=STAGES, **kind, **SETTINGS)
    start = make_moving_stage().snapshot()
    wait = np.tile([WAIT, 0, 0, 0], (STAGES, 1))

    def prepare() -> None:
        envs.reset(seed=0)
        for s in envs.unwrapped.stages:
            s.restore(start)

    return prepare, lambda: repeat(plays, lambda: envs.step(wait))


def make_batch_work(threads: int, plays: int) -> tuple[Callable[[], None], Callable[[], None]]:
    """Make a work of a batch of bare models.

    Args:
        threads: Number of threads.
        plays: Number of steps in a call.

    Returns:
        Preparation and work.
    """
    bare = MujocoBatch(STAGES, threads)
    bare.nstep = STEPS
    return bare.reset, lambda: repeat(plays, bare.step)


def repeat(n: int, work: Callable[[], Any]) -> None:
    """Call `work` n times."""
    for _ in range(n):
        work()


def make_wait_programs(stages: int, steps: int) -> np.ndarray:
    """Make a program for each stage that waits for a number of physics steps, (stages, 1, 4)."""
    ops = Program().wait(steps * DT).ops
    return np.tile(np.array(ops), (stages, 1, 1))
