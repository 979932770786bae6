"""Snapshots of environments, for planning: an episode continues from a snapshot bit for bit.

    saved = env.snapshot()
    for action in candidates:            tries each action from the same moment
        env.restore(saved)
        env.step(action)

A snapshot contains the physics, chips, drives and switches; the payload, friction and switch position that the environment
drew; the arrays of the task; the random generator; and the last observation and result. It can be restored into any environment
with the same settings, also in another process (by pickle). It does not contain faults and forces that the user applied, the
random generators of the spaces, frames or recordings.
"""

from __future__ import annotations

import pickle
import zlib
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np

from stage.chips import chip_class
from stage.envs.task import Task
from stage.errors import ArgumentError, StageError
from stage.support import snapshots


class EnvSnapshot(snapshots.Snapshot):
    """Complete state of an environment or a vector environment, from which its episodes continue bit for bit."""

    of: ClassVar = "an environment"


def make_header(task: Task) -> snapshots.SnapshotHeader:
    """Return the description of a task's environment that its snapshots carry; the first call makes the description."""
    if task.header is None:
        task.header = _describe_task(task)
    return task.header


def _describe_task(task: Task) -> snapshots.SnapshotHeader:
    """Describe a task by its class, its number of stages, its settings and its model."""
    parts = [("environment", type(task).__name__), ("stages", str(task.n))]
    for f in fields(task.config):
        value = getattr(task.config, f.name)
        if f.name == "chip" and value is not None:
            value = chip_class(value).__name__
        elif f.name == "model" and not isinstance(value, str | None):
            continue  # the header of the stage describes its mechanics
        parts.append((f"setting {f.name}", repr(value)))
    return snapshots.SnapshotHeader((*parts, *task.start.header.parts))


def take_snapshot(task: Task, more: Any) -> EnvSnapshot:
    """Take a snapshot of all stages of a task.

    Args:
        task: Task whose episodes are saved.
        more: Additional object to save, which pickle can handle; `restore_snapshot` returns it.
    """
    episodes = [task.save_episode(k) for k in range(task.n)]
    state = pickle.dumps((episodes, more), pickle.HIGHEST_PROTOCOL)
    of = make_header(task)
    return EnvSnapshot(of, state, (), zlib.crc32(state, of.checksum))


def restore_snapshot(task: Task, snapshot: Any) -> Any:
    """Restore all stages of a task from a snapshot.

    Args:
        task: Task with the settings of the one that was saved.
        snapshot: Snapshot of `take_snapshot`.

    Returns:
        The object that `take_snapshot` saved as `more`.

    Raises:
        ArgumentError: The snapshot is of another environment; nothing has changed.
        StageError: A stage is being recorded; nothing has changed.
    """
    snapshots.check_restorable(snapshot, EnvSnapshot, make_header(task))
    if any(stage.recording is not None for stage in task.stages):
        raise StageError("time in a recording runs forward only: restore in an environment without record=.")
    episodes, more = pickle.loads(snapshot.state)
    for k, of_stage in enumerate(episodes):
        task.load_episode(k, of_stage)
    return more


def require_episodes(episodes: Sequence[bool] | np.ndarray) -> None:
    """Raise ArgumentError unless every environment has begun an episode.

    Args:
        episodes: For each environment, whether it has begun an episode.
    """
    if not all(episodes):
        raise ArgumentError("there is no episode to take a snapshot of: call reset() first.")
