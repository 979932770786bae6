"""Policies: what `stage bench-submit` plays.

A policy is any of
    module:name          a function (observation, info) -> action; an object with such a __call__; or a class without arguments that
                         makes one. If it has a method `reset(around)`, that is called before each episode, see `Around`
    moves.npz            recorded actions: an array `actions`, (episodes, steps, ...), or (steps in all, ...) with an array `steps`
    random, ...          a player that is shipped, see shipped.py

In Python also such a function or object itself. `info` is without what the track does not show.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from registerbench.shipped_policies import PLAYERS, SHIPPED
from stage.errors import ArgumentError, unknown_name_error
from stage.support.foreign_files import DocumentError, parse_array, read_bytes, read_members

Policy = Callable[[np.ndarray, Mapping[str, Any]], Any]


@dataclass(frozen=True)
class PolicyContext:
    """Context of a policy before an episode.

    Attributes:
        task: Name of the card.
        action_space: Of the environment.
        observation_space: Of the environment.
        entries: Name of each number of the observation.
        env: The environment itself, for shipped players alone.
    """

    task: str
    action_space: Any
    observation_space: Any
    entries: tuple[str, ...]
    env: Any = None


LARGEST, UNPACKED = 1 << 28, 1 << 30
"""Bytes of a file of actions, and of its arrays."""


class Player(Protocol):
    """A policy with its name, and the cost that it states."""

    name: str

    @property
    def cost(self) -> dict[str, float]: ...

    def begin(self, context: PolicyContext) -> None: ...
    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any: ...
    def end(self) -> None: ...


def player(policy: str | Policy, task: str, seed: int) -> Player:
    """Return the player of a policy.

    Args:
        policy: Its name, or the policy itself.
        task: Name of the card.
        seed: For shipped players that draw.

    Raises:
        ArgumentError: There is no such player.
    """
    if not isinstance(policy, str):
        if not callable(policy):
            raise ArgumentError(f"policy {policy!r}: a function (observation, info) -> action, or a name.")
        return UserPolicy(policy, str(getattr(policy, "__name__", type(policy).__name__)))
    shipped = {**PLAYERS, **SHIPPED.get(task, {})}
    if policy in shipped:
        return UserPolicy(shipped[policy](seed), policy, shipped=True)
    if policy.endswith(".npz"):
        return Recorded(policy)
    if ":" in policy:
        return UserPolicy(_policy(policy), policy)
    near = unknown_name_error(f"player of {task}", policy, shipped)
    raise ArgumentError(f"{near} Or give module:function, or an .npz of actions.")


def imported(name: str, kind: str) -> Any:
    """Import what `module:attribute` names, also from a module in this folder.

    Args:
        name: "module:attribute".
        kind: Of what, for errors.

    Raises:
        ArgumentError: There is no such attribute.
    """
    module, _, attribute = name.partition(":")
    if not all(part.isidentifier() for part in module.split(".")):
        raise ArgumentError(
            f"{kind} {name}: {module!r} is no name of a module. Name a module that Python finds from this folder."
        )
    if "" not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return getattr(importlib.import_module(module), attribute)
    except ImportError as why:
        raise ArgumentError(f"{kind} {name}: {why}. Name a module that Python finds from this folder.") from why
    except AttributeError:
        raise ArgumentError(f"{kind} {name}: module {module} has no {attribute!r}.") from None


def _policy(name: str) -> Policy:
    found = imported(name, "policy")
    if isinstance(found, type):
        found = found()
    if not callable(found):
        raise ArgumentError(f"policy {name}: is no function of (observation, info).")
    return found


class UserPolicy:
    """A policy from outside, or a shipped one."""

    def __init__(self, policy: Policy, name: str, shipped: bool = False):
        self.policy, self.name, self.shipped = policy, name, shipped

    def begin(self, context: PolicyContext) -> None:
        reset = getattr(self.policy, "reset", None)
        if reset is not None:
            reset(context if self.shipped else PolicyContext(**{**vars(context), "env": None}))

    @property
    def cost(self) -> dict[str, float]:
        return dict(getattr(self.policy, "cost", {}))

    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        return self.policy(observation, info)

    def end(self) -> None:
        pass


class Recorded:
    """Actions from a file."""

    cost: dict[str, float] = {}  # noqa: RUF012 (a Player's)

    def __init__(self, path: str):
        self.name = path
        self.episodes = _read_episodes(path)
        self.episode, self.at = -1, 0

    def begin(self, context: PolicyContext) -> None:
        self.episode, self.at = self.episode + 1, 0
        if self.episode >= len(self.episodes):
            raise ArgumentError(f"{self.name}: actions for {len(self.episodes)} episodes, and there are more.")

    def act(self, observation: np.ndarray, info: Mapping[str, Any]) -> Any:
        rows = self.episodes[self.episode]
        if self.at >= len(rows):
            raise ArgumentError(f"{self.name}: episode {self.episode} goes on after its {len(rows)} actions.")
        self.at += 1
        return rows[self.at - 1]

    def end(self) -> None:
        if self.at < len(self.episodes[self.episode]):
            raise ArgumentError(
                f"{self.name}: episode {self.episode} was over after {self.at} actions; there are more."
            )


def _read_episodes(path: str) -> list[np.ndarray]:
    """Return the actions of each episode in an .npz. Raises ArgumentError."""

    def refuse(why: str) -> ArgumentError:
        return ArgumentError(f"{path}: no .npz with an array `actions` ({why}).")

    content = read_bytes(path, "file of actions", LARGEST, ArgumentError)
    members = read_members(content, ["actions.npy"], UNPACKED, refuse, optional=["steps.npy"])
    try:
        arrays = {name: parse_array(data) for name, data in members.items()}
    except DocumentError as why:
        raise refuse(str(why)) from why
    actions, steps = arrays["actions.npy"], arrays.get("steps.npy")
    if steps is None and actions.ndim < 2:
        raise ArgumentError(f"{path}: actions of shape {actions.shape}; (episodes, steps, ...), or give `steps`, too.")
    if steps is None:
        return list(actions)
    valid = steps.ndim == 1 and steps.dtype.kind in "iu" and (steps >= 0).all()
    if not valid or not actions.ndim or sum(steps.tolist()) != len(actions):
        raise ArgumentError(
            f"{path}: `steps` are whole numbers, how many actions each episode has; together they are as many as `actions`."
        )
    return np.split(actions, np.cumsum(steps)[:-1])
