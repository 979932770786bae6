"""A small policy that was trained in the environments: a table of numbers that turns what is observed into rates and ramps.

trained.json has the tables, which baselines/agent_policy.py has found by the cross-entropy method on the split train, with
seeds below 1,000,000. In tasks without a table it does what the formula does.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from registerbench.arena.players.simple import formula
from registerbench.arena.table import Table
from registerbench.arena.tool_actions import rates_of

FEATURES = {
    "one-shot": ("distance", "declared"),
    "few-shot": ("distance", "left", "best", "last_kept", "last_duration", "boldest"),
}
"""Of an observation, in the order of a table's columns; the last column is 1."""


def play(table: Table) -> None:
    """Act by the table, until the game is over."""
    kind = table.name.partition(":")[0]
    if kind not in FEATURES:
        formula(table)
        return
    weights = np.array(json.loads(files(__package__).joinpath("trained.json").read_text(encoding="utf-8"))[kind])
    observation = table.call("observe").data["observation"]
    while not table.over:
        answer = table.call("act", rates_of(action(weights, features(kind, observation))))
        if not answer.ok:
            return
        observation = answer.data["observation"]


def features(kind: str, observation: Mapping[str, Any]) -> np.ndarray:
    """Compute the inputs of the policy, with a 1 at the end.

    Args:
        kind: Of the task.
        observation: Features by name.
    """
    if kind == "one-shot":
        return np.array([observation["distance"], observation["declared"], 1.0])
    made = [k for k, m in enumerate(observation["tried"]) if m > 0]
    last = made[-1] if made else None
    kept = 0.0 if last is None else 2.0 * observation["kept"][last] - 1.0
    took = 0.0 if last is None else observation["duration"][last]
    good = [observation["tried_drive"][k] for k in made if observation["kept"][k] > 0]
    return np.array(
        [observation["distance"], observation["left"], observation["best"], kept, took, max(good, default=-1.0), 1.0]
    )


def action(weights: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Compute the environment's action, (4,), from the inputs of the policy.

    Args:
        weights: Of the policy.
        inputs: Of the policy.
    """
    return np.tanh(weights @ inputs)
