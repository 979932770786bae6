"""Playing the test episodes of a split with a policy, and packing what was played."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

from stage.arguments import told
from stage.bench.cards import OPEN
from stage.bench.episodes import Episodes
from stage.bench.files import Submission
from stage.bench.players import Around, Policy, player
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
    played = Episodes(task, split, track, round_, settings or {}, episodes)
    env = played.env
    try:
        acting = player(policy, played.card.name, run)
        if track == "tools" and "tokens" not in {**(cost or {}), **acting.cost}:
            raise ArgumentError(
                "the track tools counts tokens: give cost tokens=N, or the policy a dict `cost` with tokens, which it counts."
            )
        around = Around(
            played.card.name, env.action_space, env.observation_space, tuple(e.name for e in env.entries), env
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


@told
def submit(entry: Submission, path: str | os.PathLike, overwrite: bool = False) -> None:
    """Write an entry. Raises FileError where nothing can be written, or another file would be lost."""
    entry.write(path, overwrite)
