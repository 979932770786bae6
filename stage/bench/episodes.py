"""`Episodes`: test episodes that are played one after the other, whoever chooses the actions, and the entry that comes of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stage.bench.cards import card_of, seeds
from stage.bench.files import ACTIONS, Submission
from stage.bench.scores import digest, scored, table
from stage.bench.versions import made_of, versions
from stage.envs.entries import hidden
from stage.envs.task import checked
from stage.errors import ArgumentError


class Episodes:
    """Of a split. Raises ArgumentError for what there is not.

    Attributes: env; wanted: seeds; observation, info: what the player sees now, info without what the track does not show; over:
        the episode is; done: how many are; scores: of each.
    """

    def __init__(
        self, task: str, split: str, track: str, round_: str, settings: Mapping[str, Any], episodes: int | None = None
    ):
        self.card, self.split, self.track, self.round_, self.settings = (
            card_of(task),
            split,
            track,
            round_,
            dict(settings),
        )
        self.env = self.card.make(split, track, self.settings)
        self._unseen = frozenset() if track == "truth" else hidden(self.env.told, False)
        self.wanted = some(seeds(self.card, split, round_), episodes)
        self.observation: Any = None
        self.info: dict[str, Any] = {}
        self.over, self.done, self._begun = True, 0, 0
        self._steps: list[int] = []
        self._actions: list[np.ndarray] = []
        self._rewards: list[float] = []
        self._seen: list[int] = []
        self.scores: list[dict[str, float]] = []

    def begin(self) -> None:
        """The next episode."""
        self.observation, info = self.env.reset(seed=self.wanted[self.done])
        self._look(info)
        self._begun, self.over = len(self._rewards), False

    def act(self, action: Any) -> None:
        """A step. Raises ArgumentError for an action that the task does not take."""
        action = checked(self.env.action_space, action)
        self.observation, reward, terminated, truncated, info = self.env.step(action)
        self._actions.append(action)
        self._rewards.append(float(reward))
        self._look(info)
        self.over = bool(terminated or truncated)
        if self.over:
            self._steps.append(len(self._rewards) - self._begun)
            self.scores.append(scored(np.array(self._rewards[self._begun :]), info))
            self.done += 1

    def entry(self, player: str, run: int, notes: str, cost: Mapping[str, float]) -> Submission:
        """What was played, as a file has it."""
        space = self.env.action_space
        kind = np.dtype(space.dtype).newbyteorder("<").str
        whole: Any = np.asarray(self._actions, kind if kind in ACTIONS else "<i8")
        spent = {**cost, "test_moves": len(self._rewards)}
        return Submission(
            self.card.name, self.split, self.track, self.round_, self.settings, player, run, notes, spent, tuple(self.wanted),
            np.array(self._steps, np.int64), whole, np.array(self._rewards), np.array(self._seen, np.uint64),
            table(self.scores), versions(), made_of(self.env),
        )  # fmt: skip

    def close(self) -> None:
        """End the threads of the environment."""
        self.env.close()

    def _look(self, info: Mapping[str, Any]) -> None:
        self._seen.append(digest(self.observation))
        self.info = {key: v for key, v in info.items() if key not in self._unseen}


def some(every: list[int], episodes: int | None) -> list[int]:
    """The first so many. Raises ArgumentError."""
    if episodes is None:
        return every
    if not 1 <= episodes <= len(every):
        raise ArgumentError(f"episodes={episodes}: 1 to {len(every)} here.")
    return every[:episodes]
