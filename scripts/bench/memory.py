"""Memory that a stage takes, each kind measured in a fresh process."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

import stage.envs  # noqa: F401 registers the ids
from bench.figures import Figure, Run
from bench.machines import Batch, moving_stage
from bench.timing import has_resident, in_a_fresh_process, resident

TITLE = "Memory of a stage"
KINDS = {
    "stage": "a Stage, in motion",
    "bare_stage": "  without visuals (visuals=False)",
    "env": "a stage of the vector RegisterBus",
    "batch": "a simulation of a bare Batch",
}


def measure(run: Run) -> Iterator[Figure]:
    if not has_resident():
        print("    left out: memory is read from /proc, which is not here")
        return
    n = run.pick(256, 32)
    kib = {kind: [in_a_fresh_process(grow, kind, n) for _ in range(run.pick(3, 1))] for kind in KINDS}
    for kind, name in KINDS.items():
        yield Figure.of(f"memory.{kind}", name, "KiB", kib[kind], f"growth by {n}, a fresh process each")
    ratio = np.array(kib["env"]) / np.array(kib["bare_stage"])
    yield Figure.of("memory.env_stage", "a stage of the vector environment / a Stage without visuals", "ratio", ratio)


def grow(kind: str, n: int) -> float:
    """KiB that each of n more takes, after it has moved, beyond the first of its kind."""
    created = [make(kind, 2)]
    before = resident()
    created.append(make(kind, n))
    return (resident() - before) / n / 1024


def make(kind: str, n: int) -> Any:
    if "stage" in kind:
        first = moving_stage(visuals=kind == "stage")
        stages = [first, *(copy.deepcopy(first) for _ in range(n - 1))]
        for s in stages:
            s.step(4)
        return stages
    if kind == "batch":
        batch = Batch(n, 0)
        batch.reset()
        batch.step()
        return batch
    envs = gymnasium.make_vec("stage/RegisterBus-v0", num_envs=n, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    return envs
