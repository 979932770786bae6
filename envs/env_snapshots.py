"""Snapshots of environments, for planning: an episode continues from a snapshot bit for bit.

    kept = env.snapshot()
    for action in candidates:            look ahead from the same moment, as often as you like
        env.restore(kept)
        env.step(action)

A snapshot has the physics, chips, drives and switches; the payload, friction and place of a switch that the environment drew; the
task's own numbers; the random generator; the last observation and result. It restores into any environment with the same settings,
in this process or another (pickle). Not in it: what you did to the machine yourself (faults, forces), the generators of the spaces,
the frames and recordings.
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
    """All state of an environment, or of a vector of them; see the module."""

    of: ClassVar = "an environment"


def make_header(task: Task) -> snapshots.Header:
    """Describe the environment of a task, for its snapshots."""
    if task.header is None:
        task.header = _describe_task(task)
    return task.header


def _describe_task(task: Task) -> snapshots.Header:
    parts = [("environment", type(task).__name__), ("stages", str(task.n))]
    for f in fields(task.config):
        value = getattr(task.config, f.name)
        if f.name == "chip" and value is not None:
            value = chip_class(value).__name__
        elif f.name == "model" and not isinstance(value, str | None):
            continue  # its mechanics are in what follows
        parts.append((f"setting {f.name}", repr(value)))
    return snapshots.Header((*parts, *task.start.header.parts))


def take_snapshot(task: Task, more: Any) -> EnvSnapshot:
    """Take a snapshot of all stages of a task.

    Args:
        task: Whose episodes to save.
        more: Anything that can be pickled; `restore_snapshot` returns it.
    """
    episodes = [task.save_stage(k) for k in range(task.n)]
    state = pickle.dumps((episodes, more), pickle.HIGHEST_PROTOCOL)
    of = make_header(task)
    return EnvSnapshot(of, state, (), zlib.crc32(state, of.checksum))


def restore_snapshot(task: Task, snapshot: Any) -> Any:
    """Put a task back to a snapshot.

    Args:
        task: Of the same settings.
        snapshot: To restore.

    Returns:
        The value `more` of `take_snapshot`.

    Raises:
        ArgumentError: The snapshot is of another environment; nothing has changed.
        StageError: A stage is being recorded; nothing has changed.
    """
    snapshots.check_restorable(snapshot, EnvSnapshot, make_header(task))
    if any(stage.recording is not None for stage in task.stages):
        raise StageError("time in a recording runs forward only: restore in an environment without record=.")
    episodes, more = pickle.loads(snapshot.state)
    for k, of_stage in enumerate(episodes):
        task.load_stage(k, of_stage)
    return more


def require_episodes(episodes: Sequence[bool] | np.ndarray) -> None:
    """Raise ArgumentError if an environment has not begun an episode."""
    if not all(episodes):
        raise ArgumentError("there is no episode to take a snapshot of: call reset() first.")
