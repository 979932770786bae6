"""Playing the test episodes of a split with a policy, and packing what was played."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stage.bench.cards import OPEN, card_of, seeds
from stage.bench.files import ACTIONS, Submission
from stage.bench.players import Around, Policy, player
from stage.bench.scores import digest, scored, table
from stage.bench.versions import made_of, versions
from stage.envs.entries import hidden
from stage.envs.task import checked
from stage.errors import ArgumentError


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
    card, chosen = card_of(task), dict(settings or {})
    env = card.make(split, track, chosen)
    acting = player(policy, card.name, run)
    if track == "tools" and "tokens" not in {**(cost or {}), **acting.cost}:
        raise ArgumentError(
            "the track tools counts tokens: give cost tokens=N, or the policy a dict `cost` with tokens, which it counts."
        )
    around = Around(card.name, env.action_space, env.observation_space, tuple(e.name for e in env.entries), env)
    unseen = frozenset() if track == "truth" else hidden(env.told, False)
    wanted = some(seeds(card, split, round_), episodes)
    steps: list[int] = []
    actions: list[np.ndarray] = []
    rewards: list[float] = []
    seen: list[int] = []
    scores: list[dict[str, float]] = []
    try:
        for k, seed in enumerate(wanted):
            observation, info = env.reset(seed=seed)
            acting.begin(around)
            seen.append(digest(observation))
            begun, over = len(rewards), False
            while not over:
                action = acting.act(observation, {key: v for key, v in info.items() if key not in unseen})
                action = checked(env.action_space, action)
                observation, reward, terminated, truncated, info = env.step(action)
                actions.append(action)
                rewards.append(float(reward))
                seen.append(digest(observation))
                over = terminated or truncated
            acting.end()
            steps.append(len(rewards) - begun)
            scores.append(scored(np.array(rewards[begun:]), info))
            if told:
                told(k + 1, len(wanted))
        made = made_of(env)
    finally:
        env.close()
    spent = {**(cost or {}), **acting.cost, "test_moves": len(rewards)}
    kind = np.dtype(env.action_space.dtype).newbyteorder("<").str
    whole: Any = np.asarray(actions, kind if kind in ACTIONS else "<i8")
    return Submission(
        card.name, split, track, round_, chosen, name or acting.name, run, notes, spent,
        tuple(wanted), np.array(steps, np.int64), whole, np.array(rewards), np.array(seen, np.uint64), table(scores),
        versions(), made,
    )  # fmt: skip


def some(every: list[int], episodes: int | None) -> list[int]:
    """The first so many. Raises ArgumentError."""
    if episodes is None:
        return every
    if not 1 <= episodes <= len(every):
        raise ArgumentError(f"episodes={episodes}: 1 to {len(every)} here.")
    return every[:episodes]


def submit(entry: Submission, path: str | os.PathLike, overwrite: bool = False) -> None:
    """Write an entry. Raises FileError where nothing can be written, or another file would be lost."""
    entry.write(path, overwrite)
