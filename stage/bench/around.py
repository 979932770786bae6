"""A policy, and what it is told of the task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Policy = Callable[[np.ndarray, Mapping[str, Any]], Any]


@dataclass(frozen=True)
class Around:
    """What a policy is told before an episode. entries: the name of each number of the observation. env: the environment itself,
    for shipped players alone."""

    task: str
    action_space: Any
    observation_space: Any
    entries: tuple[str, ...]
    env: Any = None
