"""Vector environments for learners, with settings that make training cheaper than the test episodes."""

from __future__ import annotations

from typing import Any

import gymnasium

import stage.envs  # noqa: F401 (registers the environments)
from registerbench.benchmark_tasks import CARDS

CHEAPER_SETTINGS: dict[str, dict[str, Any]] = {
    "one-shot": {"proofs": 1, "settle": 0.03, "reduced": True},
    "few-shot": {"settle": 0.03, "reduced": True},
    "few-shot-wide": {"settle": 0.03, "reduced": True},
    "home": {"reduced": True},
    "line": {"proofs": 1, "rest": 0.03},
}
"""Settings of training by the name of the card: fewer proofs and shorter waits than in the test episodes, and the reduced model."""


def make_training_envs(task: str, machines: int, **settings: Any) -> Any:
    """Make a vector environment of a task.

    Args:
        task: Name of a card.
        machines: Number of environments, each with a machine of its own.
        **settings: Settings that override those of the card.
    """
    card, kind = CARDS[task], {"vectorization_mode": "vector_entry_point", "autoreset_mode": "NextStep", "threads": 1}
    memory = {"memory": "last"} if "memory" in card.choices else {}
    return gymnasium.make_vec(card.id, machines, **kind, **{**card.settings, **memory, **settings}).unwrapped
