"""Benchmark of the memory that a stage takes, each kind measured in a fresh process."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

import stage.envs  # noqa: F401 registers the ids
from bench.figures import Figure, Run
from bench.machines import MujocoBatch, make_moving_stage
from bench.timing import can_read_resident_memory, read_resident_memory, run_in_fresh_process

TITLE = "Memory of a stage"
KINDS = {
    "stage": "a Stage, in motion",
    "bare_stage": "  without visuals (visuals=False)",
    "env": "a stage of the vector RegisterBus",
    "batch": "a simulation of a bare Batch",
}


def measure(run: Run) -> Iterator[Figure]:
    """Yield the figures of this subject."""
    if not can_read_resident_memory():
        print("    left out: memory is read from /proc, which is not here")
        return
    n = run.choose(256, 32)
    kib = {kind: [run_in_fresh_process(measure_growth, kind, n) for _ in range(run.choose(3, 1))] for kind in KINDS}
    for kind, name in KINDS.items():
        yield Figure.of(f"memory.{kind}", name, "KiB", kib[kind], f"growth by {n}, a fresh process each")
    ratio = np.array(kib["env"]) / np.array(kib["bare_stage"])
    yield Figure.of("memory.env_stage", "a stage of the vector environment / a Stage without visuals", "ratio", ratio)


def measure_growth(kind: str, n: int) -> float:
    """Measure the memory of each of n further objects after it has moved.

    Args:
        kind: Key of KINDS.
        n: Number of objects after the first.

    Returns:
        KiB for one object.
    """
    created = [make_objects(kind, 2)]
    before = read_resident_memory()
    created.append(make_objects(kind, n))
    return (read_resident_memory() - before) / n / 1024


def make_objects(kind: str, n: int) -> Any:
    """Make n objects of a kind of KINDS, and let them move."""
    if "stage" in kind:
        first = make_moving_stage(visuals=kind == "stage")
        stages = [first, *(copy.deepcopy(first) for _ in range(n - 1))]
        for s in stages:
            s.step(4)
        return stages
    if kind == "batch":
        batch = MujocoBatch(n, 0)
        batch.reset()
        batch.step()
        return batch
    envs = gymnasium.make_vec("stage/RegisterBus-v0", num_envs=n, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    return envs
