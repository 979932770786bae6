"""A player with a small trained policy: a table of weights that maps an observation to rates and ramps.

baselines/trained_policy_training.py finds the tables in trained.json by the cross-entropy method on the split train, with seeds
below 1,000,000. In tasks without a table, the player does what the formula does.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from registerbench.arena.action_converters import convert_action_to_rates
from registerbench.arena.game_session import GameSession
from registerbench.arena.players.formula_and_random import play_formula

FEATURES = {
    "one-shot": ("distance", "declared"),
    "few-shot": ("distance", "left", "best", "last_kept", "last_duration", "boldest"),
}
"""Features of an observation in the order of a table's columns; a last column of ones follows them."""


def play_trained_policy(session: GameSession) -> None:
    """Play a game by the trained policy of its task, or by the formula if there is no policy."""
    kind = session.name.partition(":")[0]
    if kind not in FEATURES:
        play_formula(session)
        return
    weights = np.array(json.loads(files(__package__).joinpath("trained.json").read_text(encoding="utf-8"))[kind])
    observation = session.call("observe").data["observation"]
    while not session.over:
        answer = session.call(
            "act", convert_action_to_rates(compute_action(weights, compute_features(kind, observation)))
        )
        if not answer.ok:
            return
        observation = answer.data["observation"]


def compute_features(task: str, observation: Mapping[str, Any]) -> np.ndarray:
    """Compute the input of the policy from an observation. Its last number is 1.

    Args:
        task: Name of the task.
        observation: Features of the observation by name.
    """
    if task == "one-shot":
        return np.array([observation["distance"], observation["declared"], 1.0])
    attempted = [k for k, m in enumerate(observation["tried"]) if m > 0]
    last = attempted[-1] if attempted else None
    last_kept = 0.0 if last is None else 2.0 * observation["kept"][last] - 1.0
    last_duration = 0.0 if last is None else observation["duration"][last]
    kept_rates = [observation["tried_drive"][k] for k in attempted if observation["kept"][k] > 0]
    return np.array(
        [
            observation["distance"],
            observation["left"],
            observation["best"],
            last_kept,
            last_duration,
            max(kept_rates, default=-1.0),
            1.0,
        ]
    )


def compute_action(weights: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Compute the environment's four actions, each -1 to 1: tanh(weights @ inputs).

    Args:
        weights: Weights of the task's policy, (4, features + 1).
        inputs: Features of the observation, and the constant 1 as the last input, (features + 1,).
    """
    return np.tanh(weights @ inputs)
