"""The scores of an episode, by the same names in every task, and the digest of an observation."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

NAMES = {
    "return": "sum of rewards",
    "success": "1 if the task was done, as the task defines it",
    "time": "s, of what was proved",
    "regret": "log(time / the time of the formula)",
    "moves": "steps of the episode",
    "lost_steps": "full steps lost",
    "limits": "moves that ended at an end limit",
}
"""Of a task with `info["score"]`; others have the return, and the time of what was proved where they have a proof."""


def scored(rewards: np.ndarray, info: Mapping[str, Any]) -> dict[str, float]:
    """Of an episode: its rewards, and the info of its last step."""
    told = info.get("score")
    if told is None:
        told = {"time": info["proved"], "success": np.isfinite(info["proved"])} if "proved" in info else {}
        told = {**told, "moves": len(rewards)}
    return {"return": float(rewards.sum()), **{name: float(value) for name, value in told.items()}}


def table(episodes: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    """By name, (episodes,)."""
    return {name: np.array([e[name] for e in episodes]) for name in episodes[0]}


def digest(observation: np.ndarray) -> int:
    """8 bytes that tell an observation from others: its type, shape and bits."""
    array = np.ascontiguousarray(observation)
    said = f"{array.dtype.str} {array.shape} ".encode()
    return int.from_bytes(hashlib.blake2b(said + array.tobytes(), digest_size=8).digest(), "little")
