"""Test episodes that are played one after the other, their scores, and the entry that comes of them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from registerbench.cards import OPEN, card_of, seeds
from registerbench.entry_files import ACTIONS, Submission
from registerbench.policies import Policy, PolicyContext, player
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
    """Return the scores of an episode.

    Args:
        rewards: Of its steps.
        info: Of its last step.
    """
    score = info.get("score")
    if score is None:
        score = {"time": info["proved"], "success": np.isfinite(info["proved"])} if "proved" in info else {}
        score = {**score, "moves": len(rewards)}
    return {"return": float(rewards.sum()), **{name: float(value) for name, value in score.items()}}


def table(episodes: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    """Return the scores of episodes by name, (episodes,)."""
    return {name: np.array([e[name] for e in episodes]) for name in episodes[0]}


def digest(observation: np.ndarray) -> int:
    """Return 8 bytes that distinguish an observation from others: its type, shape and bits."""
    array = np.ascontiguousarray(observation)
    said = f"{array.dtype.str} {array.shape} ".encode()
    return int.from_bytes(hashlib.blake2b(said + array.tobytes(), digest_size=8).digest(), "little")


class Episodes:
    """Test episodes of a split, played one after the other.

    Attributes:
        env: The environment.
        wanted: Seeds of the episodes.
        observation: What the player sees now.
        info: Likewise, without what the track hides.
        over: The episode is over.
        done: Number of finished episodes.
        scores: Of each finished episode.

    Raises:
        ArgumentError: There is no such task, split, track or round.
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
        """Begin the next episode."""
        self.observation, info = self.env.reset(seed=self.wanted[self.done])
        self._look(info)
        self._begun, self.over = len(self._rewards), False

    def act(self, action: Any) -> None:
        """Make a step. Raises ArgumentError for an action that the task does not take."""
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
        """Return what was played, as a file has it.

        Args:
            player: Name of the player.
            run: Number of the training run.
            notes: Anything to be kept with it.
            cost: What the player took.
        """
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
    """Return the first `episodes` of a list, or all for None. Raises ArgumentError."""
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
    report_progress: Callable[[int, int], None] | None = None,
) -> Submission:
    """Play the test episodes of a split.

    Args:
        policy: Name of a player, "module:attribute", or a policy; see policies.py.
        task: Name of a card.
        split: Of its machines.
        track: What the player sees.
        round_: Whose seeds are played.
        settings: As the card has them.
        name: Of the player; default: the policy's own.
        run: Number of the training run, where a learner has several.
        notes: Anything to be kept with it.
        cost: What the player took (moves, processor_s, tokens); a policy's own dict `cost` is added at the end.
        episodes: Only so many, for a trial.
        report_progress: Called with (episodes played, episodes).

    Raises:
        ArgumentError: There is no such task; the task does not take an action; the track tools has no tokens.
    """
    played = Episodes(task, split, track, round_, settings or {}, episodes)
    env = played.env
    try:
        acting = player(policy, played.card.name, run)
        if track == "tools" and "tokens" not in {**(cost or {}), **acting.cost}:
            raise ArgumentError(
                "the track tools counts tokens: give cost tokens=N, or the policy a dict `cost` with tokens, which it counts."
            )
        context = PolicyContext(
            played.card.name,
            env.action_space,
            env.observation_space,
            tuple(e.name for e in env.observation_features),
            env,
        )
        while played.done < len(played.wanted):
            played.begin()
            acting.begin(context)
            while not played.over:
                played.act(acting.act(played.observation, played.info))
            acting.end()
            if report_progress:
                report_progress(played.done, len(played.wanted))
        return played.entry(name or acting.name, run, notes, {**(cost or {}), **acting.cost})
    finally:
        env.close()
