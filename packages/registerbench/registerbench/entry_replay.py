"""Replay of an entry: its actions are played again, without the policy, and all rewards, observations and scores are compared."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from registerbench.benchmark_tasks import Card, find_card, list_test_seeds
from registerbench.entry_creation import digest_observation, score_episode
from registerbench.entry_files import Entry, EntryError, read_entry
from registerbench.package_versions import describe_environment, list_versions
from stage.envs.stage_env import extract_info
from stage.errors import ArgumentError
from stage.support.argument_checks import explain_arguments

MAX_PARALLEL_ENVS = 16  # episodes that are played at once


@dataclass(frozen=True)
class Difference:
    """First difference between an entry and its replay.

    Attributes:
        episode: Index of the episode; None if the difference concerns the whole entry.
        step: Index of the step; -1 for the reset, None for the scores of an episode.
        what: Value that differs, in words.
        claimed: Value in the entry.
        found: Value in the replay.
    """

    episode: int | None
    step: int | None
    what: str
    claimed: str
    found: str

    def __str__(self) -> str:
        where = "" if self.episode is None else f"episode {self.episode}, "
        if self.step is not None:
            where += "reset, " if self.step < 0 else f"step {self.step}, "
        return f"{where}{self.what}: {self.claimed} in the entry, {self.found} here"


@dataclass(frozen=True)
class Verdict:
    """Result of the replay of an entry.

    Attributes:
        entry: The entry.
        exact: Whether every reward, observation, end and score is equal, bit for bit.
        within_tolerance: Whether all numbers are equal within the tolerance; None without a tolerance.
        is_complete: Whether the entry has all test episodes of its round.
        first_difference: First difference, by the tolerance if something exceeds it; None if all is equal.
        largest_difference: Largest difference of a reward or score.
        differing_versions: (name, in the entry, on this machine) of the versions that differ.
        tolerance: Tolerance of rewards and scores.
        differing_observations: Number of observations that differ.
    """

    entry: Entry
    exact: bool
    within_tolerance: bool | None
    is_complete: bool
    first_difference: Difference | None
    largest_difference: float
    differing_versions: tuple[tuple[str, str, str], ...] = ()
    tolerance: float | None = None
    differing_observations: int = field(default=0)

    @property
    def is_confirmed(self) -> bool:
        """True if the replay confirms the entry, exactly or within the tolerance."""
        return self.exact or bool(self.within_tolerance)

    def json(self) -> dict[str, Any]:
        """Return the verdict as `stage bench-verify --json` prints it."""
        e, first = self.entry, self.first_difference
        return {
            "ok": self.is_confirmed, "exact": self.exact, "within": self.within_tolerance, "tolerance": self.tolerance,
            "whole": self.is_complete, "task": e.task, "split": e.split, "track": e.track, "round": e.round,
            "player": e.player, "run": e.run,
            "episodes": len(e.seeds), "steps": len(e.rewards), "return": float(e.scores["return"].mean()),
            "first_difference": None if first is None else {**vars(first), "text": str(first)},
            "largest_difference": self.largest_difference if np.isfinite(self.largest_difference) else None,
            "observations_that_differ": self.differing_observations, "unlike": [list(row) for row in self.differing_versions],
        }  # fmt: skip

    def __str__(self) -> str:
        e = self.entry
        lines = [
            f"{e.player}, {e.task} {e.split}, track {e.track}, round {e.round}: {len(e.seeds)} episodes, {len(e.rewards)} steps"
        ]
        if self.exact:
            lines.append("OK: every reward, observation, end and score is equal, bit for bit")
        elif self.within_tolerance:
            lines.append(
                f"equal within {self.tolerance:g}, not bit for bit: rewards and scores differ by at most "
                f"{self.largest_difference:.3g}, {self.differing_observations} of {len(e.observation_digests)} observations "
                "are not the same bits"
            )
        else:
            lines.append(f"DIFFERS first in {self.first_difference}")
        if not self.is_complete:
            lines.append("This entry has only a part of the test episodes, and can stand in no table.")
        lines.append(f"mean return {e.scores['return'].mean():.4f}")
        if self.differing_versions and not self.exact:
            lines.append("The entry was made with other versions than these, which may be the cause:")
            lines += [f"  {name}: {theirs} there, {ours} here" for name, theirs, ours in self.differing_versions]
        elif not self.is_confirmed:
            lines.append(
                "The entry was made with these versions on such a processor, so its content is not what was played."
            )
        return "\n".join(lines)


@explain_arguments
def verify(
    entry: Entry | str | os.PathLike,
    tolerance: float | None = None,
    report_progress: Callable[[int, int], None] | None = None,
) -> Verdict:
    """Replay an entry and compare.

    Args:
        entry: An entry, or the path of its file.
        tolerance: Largest allowed difference of rewards and scores; None: they have to be equal, bit for bit.
        report_progress: Called with (episodes replayed, all episodes).

    Raises:
        EntryError: The file is not an entry, or the entry cannot be replayed here.
    """
    if tolerance is not None and not 0 <= tolerance < np.inf:
        raise ArgumentError(f"tolerance={tolerance!r}: must be 0 or greater.")
    e = entry if isinstance(entry, Entry) else read_entry(entry)
    card = _find_replayable_card(e)
    lanes = min(MAX_PARALLEL_ENVS, len(e.seeds))
    envs = card.make_env(e.split, e.track, e.settings, lanes)
    try:
        _check_actions(e, envs.single_action_space)
        replay = _Replay(e, tolerance)
        replay.replay_all(envs, report_progress)
        current = {**list_versions(), **describe_environment(envs)}
    finally:
        envs.close()
    recorded = {**e.versions, **e.made_of}
    version_rows = [
        (what, recorded.get(what, "none"), current.get(what, "none")) for what in dict.fromkeys([*recorded, *current])
    ]
    differing = tuple((what, a, b) for what, a, b in version_rows if a != b)
    return Verdict(
        e,
        exact=replay.first_difference is None,
        within_tolerance=None if tolerance is None else not replay.exceeds_tolerance,
        is_complete=len(e.seeds) == card.episodes,
        first_difference=replay.first_beyond_tolerance or replay.first_difference,
        largest_difference=replay.largest_difference,
        differing_versions=differing,
        tolerance=tolerance,
        differing_observations=replay.differing_observations,
    )  # fmt: skip


def _find_replayable_card(e: Entry) -> Card:
    """Return the card of an entry whose seeds are test episodes of its task. Raises EntryError for any other entry."""
    try:
        card = find_card(e.task)
        if e.task != card.name:
            raise EntryError(f"the entry names the task {e.task!r}, and must name it {card.name!r}.")
        card.check_choice(e.split, e.track, e.settings)
    except ArgumentError as why:
        raise EntryError(f"this entry cannot be replayed here: {why}") from None
    expected = list_test_seeds(card, e.split, e.round)
    if list(e.seeds) != expected[: len(e.seeds)]:
        k = next((k for k, (a, b) in enumerate(zip(e.seeds, expected, strict=False)) if a != b), len(expected))
        actual, right = (str(s[k]) if k < len(s) else "none" for s in (e.seeds, expected))
        raise EntryError(
            f"seed of episode {k}: {actual} in the entry, {right} in the round {e.round!r} of {e.task} {e.split}."
        )
    return card


def _check_actions(e: Entry, space: Any) -> None:
    """Raise EntryError if the actions have another type or shape than the action space, or lie outside it."""
    expected = np.dtype(space.dtype)
    if e.actions.shape[1:] != space.shape or e.actions.dtype != expected:
        raise EntryError(
            f"actions of type {e.actions.dtype} and shape {e.actions.shape[1:]} in the entry, and {e.task} takes {expected} and "
            f"{space.shape}."
        )
    for k, action in enumerate(e.actions):
        if not space.contains(action):
            raise EntryError(f"action {k}, {action.tolist()}, is not in {space}.")


class _Replay:
    """Comparison of an entry with its replay, and the differences so far.

    Attributes:
        first_difference: The first one in the order of episodes and steps.
        first_beyond_tolerance: The first one that exceeds the tolerance.
        exceeds_tolerance: Whether there is such a difference.
        largest_difference: Largest difference of numbers.
        differing_observations: Number of observations with another digest.
        first_steps: Index of the first step of each episode.
    """

    def __init__(self, e: Entry, tolerance: float | None):
        self.e, self.tolerance = e, tolerance
        self.first_difference: Difference | None = None
        self.first_beyond_tolerance: Difference | None = None
        self.exceeds_tolerance, self.largest_difference, self.differing_observations = False, 0.0, 0
        self.first_steps = np.concatenate([[0], np.cumsum(e.steps)])

    def note_difference(self, difference: Difference, by: float) -> None:
        """Store a difference between the entry and its replay, if it is the first or the largest so far.

        Args:
            difference: Place and values of the difference.
            by: Absolute difference of numbers; infinite for other values; NaN for observations, of which there are only digests.
        """
        if self.first_difference is None or _is_earlier(difference, self.first_difference):
            self.first_difference = difference
        if np.isnan(by):
            self.differing_observations += 1
            if self.tolerance is not None:
                return
        else:
            self.largest_difference = max(self.largest_difference, by)
        if self.tolerance is None or by > self.tolerance:
            self.exceeds_tolerance = True
            if self.first_beyond_tolerance is None or _is_earlier(difference, self.first_beyond_tolerance):
                self.first_beyond_tolerance = difference

    def replay_all(self, envs: Any, report_progress: Callable[[int, int], None] | None) -> None:
        """Replay all episodes, with one episode in each environment at a time.

        An environment for which no episode is left replays its last episode once more; this replay does not count.
        """
        e, n = self.e, envs.num_envs
        queue = list(range(len(e.seeds)))
        playing, step_numbers = np.zeros(n, np.int64), np.zeros(n, np.int64)
        needs_reset, is_counted, is_over = np.ones(n, bool), np.zeros(n, bool), np.ones(n, bool)
        rewards: list[list[float]] = [[] for _ in range(n)]
        while queue or is_counted.any():
            needs_reset[:] = is_over
            for lane in np.flatnonzero(is_over).tolist():
                is_counted[lane] = bool(queue)
                playing[lane] = queue.pop(0) if queue else playing[lane]
                step_numbers[lane], rewards[lane] = 0, []
            if is_over.any():
                seeds = [int(e.seeds[k]) for k in playing]
                observations, _ = envs.reset(seed=seeds, options={"reset_mask": needs_reset})
                for lane in np.flatnonzero(needs_reset & is_counted).tolist():
                    self.compare_observation(int(playing[lane]), -1, observations[lane])
            rows = np.minimum(self.first_steps[playing] + step_numbers, self.first_steps[playing + 1] - 1)
            observations, new_rewards, terminated, truncated, infos = envs.step(e.actions[rows])
            ends = terminated | truncated
            is_over[:] = ends
            for lane in np.flatnonzero(is_counted).tolist():
                k, step = int(playing[lane]), int(step_numbers[lane])
                rewards[lane].append(float(new_rewards[lane]))
                self._compare_number(k, step, "reward", float(e.rewards[self.first_steps[k] + step]), rewards[lane][-1])
                self.compare_observation(k, step, observations[lane])
                last = step + 1 == int(e.steps[k])
                if last != ends[lane]:
                    words = {True: "over", False: "goes on"}
                    self.note_difference(
                        Difference(k, step, "end of the episode", words[last], words[bool(ends[lane])]), np.inf
                    )
                elif last:
                    self.compare_scores(k, score_episode(np.array(rewards[lane]), extract_info(infos, lane)))
                is_over[lane] |= last
                is_counted[lane] = not is_over[lane]
                if is_over[lane] and report_progress:
                    report_progress(len(e.seeds) - len(queue) - int(is_counted.sum()), len(e.seeds))
            step_numbers += 1

    def compare_observation(self, episode: int, step: int, observation: np.ndarray) -> None:
        """Compare the digest of an observation with that of the entry."""
        claimed, found = (
            int(self.e.observation_digests[self.first_steps[episode] + episode + step + 1]),
            digest_observation(observation),
        )
        if claimed != found:
            self.note_difference(
                Difference(episode, step, "digest of the observation", f"{claimed:016x}", f"{found:016x}"), np.nan
            )

    def compare_scores(self, episode: int, found: Mapping[str, float]) -> None:
        """Compare the scores of an episode with those of the entry."""
        if set(found) != set(self.e.scores):
            texts = (", ".join(names) for names in (self.e.scores, found))
            self.note_difference(Difference(episode, None, "names of the scores", *texts), np.inf)
            return
        for name, value in found.items():
            self._compare_number(episode, None, f"score {name!r}", float(self.e.scores[name][episode]), value)

    def _compare_number(self, episode: int, step: int | None, what: str, claimed: float, found: float) -> None:
        """Compare a number of the entry with that of the replay, and store a difference.

        Args:
            episode: Index of the episode.
            step: Index of the step, or None for scores.
            what: Name of the number, in words.
            claimed: Number of the entry.
            found: Number of the replay.
        """
        if np.float64(claimed).tobytes() != np.float64(found).tobytes():
            by = abs(claimed - found)
            self.note_difference(
                Difference(episode, step, what, repr(claimed), repr(found)), np.inf if np.isnan(by) else by
            )


def _is_earlier(difference: Difference, other: Difference) -> bool:
    """Return whether a difference comes before another one in the order of episodes and steps."""

    def get_sort_key(d: Difference) -> tuple[float, float]:
        return (np.inf if d.episode is None else d.episode, np.inf if d.step is None else d.step)

    return get_sort_key(difference) < get_sort_key(other)
