"""Test episodes that are played one after the other, their scores, and the entry that comes of them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from registerbench.cards import OPEN, card_of, seeds
from registerbench.entry_files import ACTIONS, Submission
from registerbench.policies import Around, Policy, player
from registerbench.versions import made_of, versions
from stage.envs.features import list_hidden
from stage.envs.task import check_action
from stage.errors import ArgumentError

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
        self._unseen = frozenset() if track == "truth" else list_hidden(self.env.info_features, False)
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
        action = check_action(self.env.action_space, action)
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


def play(
    policy: str | Policy,
    task: str,
    split: str = "train",
    *,
    track: str = "host",
    round_: str = OPEN,
    settings: Mapping[str, Any] | None = None,
    name: str | None = None,
    run: int = 0,
    notes: str = "",
    cost: Mapping[str, float] | None = None,
    episodes: int | None = None,
    told: Callable[[int, int], None] | None = None,
) -> Submission:
    """Play the test episodes of a split.

    policy: see players.py. task: the name of a card. track, settings: as the card has them. name: of the player, by default the
    policy's own; run: number of the training run, where a learner has several; cost: what it took (moves, processor_s, tokens), to
    which a policy's own dict `cost` is added at the end; episodes: only so many of them, for a trial; told: called with (episodes
    played, of).

    Raises ArgumentError for what there is not, for an action that the task does not take, and on the track tools without tokens.
    """
    played = Episodes(task, split, track, round_, settings or {}, episodes)
    env = played.env
    try:
        acting = player(policy, played.card.name, run)
        if track == "tools" and "tokens" not in {**(cost or {}), **acting.cost}:
            raise ArgumentError(
                "the track tools counts tokens: give cost tokens=N, or the policy a dict `cost` with tokens, which it counts."
            )
        around = Around(
            played.card.name,
            env.action_space,
            env.observation_space,
            tuple(e.name for e in env.observation_features),
            env,
        )
        while played.done < len(played.wanted):
            played.begin()
            acting.begin(around)
            while not played.over:
                played.act(acting.act(played.observation, played.info))
            acting.end()
            if told:
                told(played.done, len(played.wanted))
        return played.entry(name or acting.name, run, notes, {**(cost or {}), **acting.cost})
    finally:
        env.close()
