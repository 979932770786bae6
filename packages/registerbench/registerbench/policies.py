"""Policies, which choose the actions that `stage bench-submit` plays.

A policy is one of
    module:name          a function (observation, info) -> action, an object with such a __call__, or a class without arguments
                         that makes such an object. If it has a method `reset(context)`, that is called with a `PolicyContext`
                         before each episode
    moves.npz            recorded actions: an array `actions`, (episodes, steps, ...), or (all steps, ...) with an array `steps`
    random, ...          a shipped player, see shipped_policies.py

A `module:name` plays in a process of its own, over a pipe (policy_process.py). In Python a policy may also be such a function or
object itself, which plays in this process. Its `info` lacks the entries that the track hides.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np

from registerbench.shipped_policies import COMMON_PLAYERS, TASK_PLAYERS
from stage.errors import ArgumentError, unknown_name_error
from stage.support.foreign_files import DocumentError, parse_array, read_bytes, read_members

Policy = Callable[[np.ndarray, Mapping[str, Any]], Any]


@dataclass(frozen=True)
class PolicyContext:
    """Information for a policy before an episode.

    Attributes:
        task: Name of the card.
        action_space: Action space of the environment.
        observation_space: Observation space of the environment.
        feature_names: Name of each number of the observation.
        env: The environment itself, for shipped players alone; None for others.
    """

    task: str
    action_space: Any
    observation_space: Any
    feature_names: tuple[str, ...]
    env: Any = None


MAX_FILE_BYTES, MAX_UNPACKED_BYTES = 1 << 28, 1 << 30
"""Largest file of recorded actions that is read, and largest size of its unpacked arrays."""


class Player(Protocol):
    """Interface of players: a policy that chooses actions, with its name and the cost that it states."""

    name: str

    @property
    def cost(self) -> dict[str, float]: ...

    def begin(self, policy_context: PolicyContext) -> None: ...
    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any: ...
    def end(self) -> None: ...


def make_player(policy: str | Policy, task: str, seed: int, sandbox: Sequence[str] = ()) -> Player:
    """Make the player of a policy.

    Args:
        policy: Name of the policy, or the policy itself.
        task: Name of the card.
        seed: Seed of shipped players that act at random.
        sandbox: Words of a command that starts the process of "module:name"; () for none.

    Raises:
        ArgumentError: There is no such player.
    """
    if not isinstance(policy, str):
        if not callable(policy):
            raise ArgumentError(f"policy {policy!r}: a function (observation, info) -> action, or a name.")
        return PolicyPlayer(policy, str(getattr(policy, "__name__", type(policy).__name__)))
    shipped = {**COMMON_PLAYERS, **TASK_PLAYERS.get(task, {})}
    if policy in shipped:
        return PolicyPlayer(shipped[policy](seed), policy, shipped=True)
    if policy.endswith(".npz"):
        return RecordedActionsPlayer(policy)
    if ":" in policy:
        from registerbench.policy_process import ProcessPolicy

        return ProcessPolicy(policy, sandbox)
    message = unknown_name_error(f"player of {task}", policy, shipped)
    raise ArgumentError(f"{message} Or give module:function, or an .npz of actions.")


def import_attribute(name: str, kind: str) -> Any:
    """Import the object that `module:attribute` names; the module may also lie in the current folder.

    Args:
        name: Name of the object, as "module:attribute".
        kind: Kind of the object, for error messages.

    Raises:
        ArgumentError: There is no such module or attribute.
    """
    module, _, attribute = name.partition(":")
    if not all(part.isidentifier() for part in module.split(".")):
        raise ArgumentError(
            f"{kind} {name}: {module!r} is not the name of a module. Name a module that Python finds from this folder."
        )
    if "" not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(importlib.import_module(module), attribute)
    except ImportError as why:
        raise ArgumentError(f"{kind} {name}: {why}. Name a module that Python finds from this folder.") from why
    except AttributeError:
        raise ArgumentError(f"{kind} {name}: module {module} has no {attribute!r}.") from None


def import_policy(name: str) -> Policy:
    """Import the policy that `module:attribute` names; make an object of a class. Raises ArgumentError."""
    policy = import_attribute(name, "policy")
    if isinstance(policy, type):
        policy = policy()
    if not callable(policy):
        raise ArgumentError(f"policy {name}: it is not a function of (observation, info).")
    return policy


class PolicyPlayer:
    """Player that calls a policy, which a user or the benchmark provides, for each action."""

    def __init__(self, policy: Policy, name: str, shipped: bool = False):
        self.policy, self.name, self.shipped = policy, name, shipped

    def begin(self, policy_context: PolicyContext) -> None:
        reset = getattr(self.policy, "reset", None)
        if reset is not None:
            reset(policy_context if self.shipped else PolicyContext(**{**vars(policy_context), "env": None}))

    @property
    def cost(self) -> dict[str, float]:
        return dict(getattr(self.policy, "cost", {}))

    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return self.policy(observation, info)

    def end(self) -> None:
        pass


class RecordedActionsPlayer:
    """Player that repeats the actions of a file, whatever it observes."""

    cost: dict[str, float] = {}  # noqa: RUF012 (replayed actions cost nothing)

    def __init__(self, path: str):
        self.name = path
        self.episodes = _read_episodes(path)
        self.episode, self.step = -1, 0

    def begin(self, policy_context: PolicyContext) -> None:
        self.episode, self.step = self.episode + 1, 0
        if self.episode >= len(self.episodes):
            raise ArgumentError(
                f"{self.name} has actions for {len(self.episodes)} episodes, but more episodes are to be played."
            )

    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        rows = self.episodes[self.episode]
        if self.step >= len(rows):
            raise ArgumentError(
                f"{self.name}: episode {self.episode} is not over after its {len(rows)} recorded actions."
            )
        self.step += 1
        return rows[self.step - 1]

    def end(self) -> None:
        if self.step < len(self.episodes[self.episode]):
            raise ArgumentError(
                f"{self.name}: episode {self.episode} was over after {self.step} actions, but more are recorded for it."
            )


def _read_episodes(path: str) -> list[np.ndarray]:
    """Return the actions of each episode in an .npz. Raises ArgumentError."""

    def make_file_error(why: str) -> ArgumentError:
        return ArgumentError(f"{path} is not an .npz file with an array `actions`: {why}.")

    content = read_bytes(path, "file of actions", MAX_FILE_BYTES, ArgumentError)
    members = read_members(content, ["actions.npy"], MAX_UNPACKED_BYTES, make_file_error, optional=["steps.npy"])
    try:
        arrays = {name: parse_array(data) for name, data in members.items()}
    except DocumentError as why:
        raise make_file_error(str(why)) from why
    actions, steps = arrays["actions.npy"], arrays.get("steps.npy")
    if steps is None and actions.ndim < 2:
        raise ArgumentError(
            f"{path}: `actions` has the shape {actions.shape}; give the shape (episodes, steps, ...), or add an array `steps`."
        )
    if steps is None:
        return list(actions)
    valid = steps.ndim == 1 and steps.dtype.kind in "iu" and (steps >= 0).all()
    if not valid or not actions.ndim or sum(steps.tolist()) != len(actions):
        raise ArgumentError(
            f"{path}: `steps` must hold the number of actions of each episode as integers, and add up to the length of `actions`."
        )
    return np.split(actions, np.cumsum(steps)[:-1])


def take_standard_output() -> TextIO:
    """Return standard output for the answers of a process. What the process prints from now on goes to standard error."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return answers
