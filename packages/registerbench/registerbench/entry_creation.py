"""Playing the test episodes of a split one after the other, and the entry that holds their actions and scores."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from registerbench.benchmark_tasks import OPEN_ROUND, find_card, list_test_seeds
from registerbench.entry_files import ACTION_TYPES, Entry
from registerbench.package_versions import describe_environment, list_versions
from registerbench.policies import Policy, PolicyContext, make_player
from stage.envs.observation_features import list_hidden_names
from stage.envs.task import check_action
from stage.errors import ArgumentError


def score_episode(rewards: np.ndarray, info: Mapping[str, Any]) -> dict[str, float]:
    """Return the scores of an episode by name.

    Args:
        rewards: Rewards of its steps.
        info: Info of its last step.
    """
    score = info.get("score")
    if score is None:
        score = {"time": info["proved"], "success": np.isfinite(info["proved"])} if "proved" in info else {}
        score = {**score, "moves": len(rewards)}
    return {"return": float(rewards.sum()), **{name: float(value) for name, value in score.items()}}


def stack_scores(episodes: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
    """Return the scores of several episodes by name, each an array (episodes,)."""
    return {name: np.array([e[name] for e in episodes]) for name in episodes[0]}


def digest_observation(observation: np.ndarray) -> int:
    """Return a hash of 8 bytes over type, shape and bits of an observation."""
    array = np.ascontiguousarray(observation)
    prefix = f"{array.dtype.str} {array.shape} ".encode()
    return int.from_bytes(hashlib.blake2b(prefix + array.tobytes(), digest_size=8).digest(), "little")


class EpisodeSequence:
    """Test episodes of a split, played one after the other.

    Attributes:
        env: The environment.
        seeds: Seeds of the episodes.
        observation: The latest observation.
        info: The latest info, without the entries that the track hides from the player.
        over: Whether the current episode is over.
        finished: Number of finished episodes.
        scores: Scores of each finished episode.

    Raises:
        ArgumentError: There is no such task, split, track or round.
    """

    def __init__(
        self, task: str, split: str, track: str, round_: str, settings: Mapping[str, Any], episodes: int | None = None
    ):
        self.card, self.split, self.track, self.round_, self.settings = (
            find_card(task),
            split,
            track,
            round_,
            dict(settings),
        )
        self.env = self.card.make_env(split, track, self.settings)
        self._hidden_names = frozenset() if track == "truth" else list_hidden_names(self.env.info_features, False)
        self.seeds = limit_episodes(list_test_seeds(self.card, split, round_), episodes)
        self.observation: Any = None
        self.info: dict[str, Any] = {}
        self.over, self.finished, self._first_step = True, 0, 0
        self._steps: list[int] = []
        self._actions: list[np.ndarray] = []
        self._rewards: list[float] = []
        self._observation_digests: list[int] = []
        self.scores: list[dict[str, float]] = []

    def begin(self) -> None:
        """Begin the next episode."""
        self.observation, info = self.env.reset(seed=self.seeds[self.finished])
        self._store_observation(info)
        self._first_step, self.over = len(self._rewards), False

    def act(self, action: Any) -> None:
        """Make one step. Raises ArgumentError for an action that is not in the action space."""
        action = check_action(self.env.action_space, action)
        self.observation, reward, terminated, truncated, info = self.env.step(action)
        self._actions.append(action)
        self._rewards.append(float(reward))
        self._store_observation(info)
        self.over = bool(terminated or truncated)
        if self.over:
            self._steps.append(len(self._rewards) - self._first_step)
            self.scores.append(score_episode(np.array(self._rewards[self._first_step :]), info))
            self.finished += 1

    def build_entry(self, player: str, run: int, notes: str, cost: Mapping[str, float], training: str = "") -> Entry:
        """Build the entry that holds the finished episodes.

        Args:
            player: Name of the player.
            run: Number of the training run.
            notes: Text to store in the entry.
            cost: What the player spent, by name: moves, processor_s, tokens.
            training: Command that trains the run and writes its entry again, or "".
        """
        space = self.env.action_space
        kind = np.dtype(space.dtype).newbyteorder("<").str
        actions: Any = np.asarray(self._actions, kind if kind in ACTION_TYPES else "<i8")
        spent = {**cost, "test_moves": len(self._rewards)}
        return Entry(
            self.card.name, self.split, self.track, self.round_, self.settings, player, run, notes, spent, tuple(self.seeds),
            np.array(self._steps, np.int64), actions, np.array(self._rewards), np.array(self._observation_digests, np.uint64),
            stack_scores(self.scores), list_versions(), describe_environment(self.env), training,
        )  # fmt: skip

    def close(self) -> None:
        """Close the environment and end its threads."""
        self.env.close()

    def _store_observation(self, info: Mapping[str, Any]) -> None:
        """Store the latest observation with its digest, and the info without what the track hides."""
        self._observation_digests.append(digest_observation(self.observation))
        self.info = {key: v for key, v in info.items() if key not in self._hidden_names}


def limit_episodes(seeds: list[int], episodes: int | None) -> list[int]:
    """Return the first `episodes` seeds, or all for None. Raises ArgumentError if there are fewer."""
    if episodes is None:
        return seeds
    if not 1 <= episodes <= len(seeds):
        raise ArgumentError(f"episodes={episodes}: give a number from 1 to {len(seeds)}.")
    return seeds[:episodes]


def play(
    policy: str | Policy,
    task: str,
    split: str = "train",
    *,
    track: str = "host",
    round_: str = OPEN_ROUND,
    settings: Mapping[str, Any] | None = None,
    name: str | None = None,
    run: int = 0,
    notes: str = "",
    cost: Mapping[str, float] | None = None,
    training: str = "",
    sandbox: Sequence[str] = (),
    episodes: int | None = None,
    report_progress: Callable[[int, int], None] | None = None,
) -> Entry:
    """Play the test episodes of a split and return the entry that holds them.

    Args:
        policy: Name of a player, "module:attribute", or a policy itself; see policies.py.
        task: Name of a card.
        split: Split from which the machines are drawn.
        track: Name of the track, which says what the player sees.
        round_: Name of the round whose seeds are played.
        settings: Settings that the card lets a player choose.
        name: Name of the player; default: the policy's own.
        run: Number of the training run, if a learner has several.
        notes: Text to store in the entry.
        cost: What the player spent (moves, processor_s, tokens); the dict `cost` of a policy is added at the end.
        training: Command that trains the run and writes its entry again, see `Entry.training`.
        sandbox: Words of a command that starts the process of a policy "module:attribute"; () for none.
        episodes: Number of episodes to play for a trial; None: all.
        report_progress: Called with (episodes played, all episodes).

    Raises:
        ArgumentError: There is no such task, the task does not take an action, or the cost of a player on the track tools has no
            tokens.
    """
    sequence = EpisodeSequence(task, split, track, round_, settings or {}, episodes)
    env, player = sequence.env, None
    try:
        player = make_player(policy, sequence.card.name, run, sandbox)
        if track == "tools" and "tokens" not in {**(cost or {}), **player.cost}:
            raise ArgumentError(
                "the track tools counts tokens: give the cost tokens=N, or give the policy a dict `cost` in which it counts tokens."
            )
        context = PolicyContext(
            sequence.card.name,
            env.action_space,
            env.observation_space,
            tuple(e.name for e in env.observation_features),
            env,
        )
        while sequence.finished < len(sequence.seeds):
            sequence.begin()
            player.begin(context)
            while not sequence.over:
                sequence.act(player.act(sequence.observation, sequence.info))
            player.end()
            if report_progress:
                report_progress(sequence.finished, len(sequence.seeds))
        return sequence.build_entry(name or player.name, run, notes, {**(cost or {}), **player.cost}, training)
    finally:
        getattr(player, "close", lambda: None)()
        env.close()
