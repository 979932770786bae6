"""Replaying an entry: its actions are played again, without the policy, and everything that came of them is compared."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from registerbench.cards import Card, card_of, seeds
from registerbench.entry_files import Refused, Submission, read
from registerbench.episodes import digest, scored
from registerbench.versions import made_of, versions
from stage.envs.base import info_of
from stage.errors import ArgumentError
from stage.support.arguments import explain_arguments

LANES = 16  # episodes that are played at once


@dataclass(frozen=True)
class Difference:
    """The first one: in which episode and step (-1: at the reset, None: of the whole entry), of what, claimed and found."""

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
    """Result of the replay of an entry."""

    entry: Submission
    exact: bool
    within: bool | None
    whole: bool
    first: Difference | None
    most: float
    unlike: tuple[tuple[str, str, str], ...] = ()
    tolerance: float | None = None
    observations: int = field(default=0)

    @property
    def ok(self) -> bool:
        """The entry is what it claims to be."""
        return self.exact or bool(self.within)

    def json(self) -> dict[str, Any]:
        """Return the verdict as `stage bench-verify --json` prints it."""
        e = self.entry
        return {
            "ok": self.ok, "exact": self.exact, "within": self.within, "tolerance": self.tolerance, "whole": self.whole,
            "task": e.task, "split": e.split, "track": e.track, "round": e.round, "player": e.player, "run": e.run,
            "episodes": len(e.seeds), "steps": len(e.rewards), "return": float(e.scores["return"].mean()),
            "first_difference": None if self.first is None else {**vars(self.first), "text": str(self.first)},
            "largest_difference": self.most if np.isfinite(self.most) else None, "observations_that_differ": self.observations,
            "unlike": [list(row) for row in self.unlike],
        }  # fmt: skip

    def __str__(self) -> str:
        e = self.entry
        lines = [
            f"{e.player}, {e.task} {e.split}, track {e.track}, round {e.round}: {len(e.seeds)} episodes, {len(e.rewards)} steps"
        ]
        if self.exact:
            lines.append("OK: every reward, observation, end and score is equal, bit for bit")
        elif self.within:
            lines.append(
                f"equal within {self.tolerance:g}, not bit for bit: rewards and scores differ by at most {self.most:.3g}, "
                f"{self.observations} of {len(e.seen)} observations are not the same bits"
            )
        else:
            lines.append(f"DIFFERS first in {self.first}")
        if not self.whole:
            lines.append("part of the test episodes alone: this entry can stand in no table")
        lines.append(f"mean return {e.scores['return'].mean():.4f}")
        if self.unlike and not self.exact:
            lines.append("made otherwise than here, which may be the cause:")
            lines += [f"  {what}: {there} there, {here} here" for what, there, here in self.unlike]
        elif not self.ok:
            lines.append("made with the same versions on the same kind of processor: the entry is not what was played")
        return "\n".join(lines)


@explain_arguments
def verify(
    entry: Submission | str | os.PathLike,
    tolerance: float | None = None,
    report_progress: Callable[[int, int], None] | None = None,
) -> Verdict:
    """Replay an entry.

    Args:
        entry: An entry, or its file.
        tolerance: Of numbers; None: they have to be equal.
        report_progress: Called with (episodes replayed, episodes).

    Raises:
        Refused: The file is no entry.
    """
    if tolerance is not None and not 0 <= tolerance < np.inf:
        raise ArgumentError(f"tolerance={tolerance!r}: 0 or more.")
    e = entry if isinstance(entry, Submission) else read(entry)
    card = _asked(e)
    lanes = min(LANES, len(e.seeds))
    envs = card.make(e.split, e.track, e.settings, lanes)
    try:
        _same_actions(e, envs.single_action_space)
        replay = _Replay(e, tolerance)
        replay.run(envs, report_progress)
        here = {**versions(), **made_of(envs)}
    finally:
        envs.close()
    there = {**e.versions, **e.made_of}
    unlike = [(what, there.get(what, "none"), here.get(what, "none")) for what in dict.fromkeys([*there, *here])]
    first = replay.first
    whole = len(e.seeds) == card.episodes
    within = None if tolerance is None else not replay.far
    different = tuple((what, a, b) for what, a, b in unlike if a != b)
    return Verdict(
        e, first is None, within, whole, replay.worst if replay.far else first, replay.most, different, tolerance,
        replay.observations,
    )  # fmt: skip


def _asked(e: Submission) -> Card:
    """The card of an entry that is of a task's test episodes; Refused for any other."""
    try:
        card = card_of(e.task)
        if e.task != card.name:
            raise Refused(f"the entry is of task {e.task!r}; {card.name!r} is meant.")
        card.check(e.split, e.track, e.settings)
    except ArgumentError as why:
        raise Refused(f"this entry cannot be replayed here: {why}") from None
    wanted = seeds(card, e.split, e.round)
    if list(e.seeds) != wanted[: len(e.seeds)]:
        k = next((k for k, (a, b) in enumerate(zip(e.seeds, wanted, strict=False)) if a != b), len(wanted))
        found, right = (str(s[k]) if k < len(s) else "none" for s in (e.seeds, wanted))
        raise Refused(
            f"seed of episode {k}: {found} in the entry, {right} in the round {e.round!r} of {e.task} {e.split}."
        )
    return card


def _same_actions(e: Submission, space: Any) -> None:
    """Raise Refused where the actions are of another type or shape than the task's."""
    wanted = np.dtype(space.dtype)
    if e.actions.shape[1:] != space.shape or e.actions.dtype != wanted:
        raise Refused(
            f"actions of type {e.actions.dtype} and shape {e.actions.shape[1:]} in the entry, and {e.task} takes {wanted} and "
            f"{space.shape}."
        )
    for k, action in enumerate(e.actions):
        if not space.contains(action):
            raise Refused(f"action {k}, {action.tolist()}, is not in {space}.")


class _Replay:
    """Differences so far; far: something differs by more than the tolerance."""

    def __init__(self, e: Submission, tolerance: float | None):
        self.e, self.tolerance = e, tolerance
        self.first: Difference | None = None
        self.worst: Difference | None = None
        self.far, self.most, self.observations = False, 0.0, 0
        self.begins = np.concatenate([[0], np.cumsum(e.steps)])

    def note(self, difference: Difference, by: float) -> None:
        """Note a difference.

        Args:
            difference: Where it is.
            by: How much numbers differ; infinite for other values; NaN for observations, of which there are only digests.
        """
        if self.first is None or _earlier(difference, self.first):
            self.first = difference
        if np.isnan(by):
            self.observations += 1
            if self.tolerance is not None:
                return
        else:
            self.most = max(self.most, by)
        if self.tolerance is None or by > self.tolerance:
            self.far = True
            if self.worst is None or _earlier(difference, self.worst):
                self.worst = difference

    def run(self, envs: Any, report_progress: Callable[[int, int], None] | None) -> None:
        """Replay all episodes, as many at once as there are stages. A stage that has no more to do plays its last one again."""
        e, n = self.e, envs.num_envs
        queue = list(range(len(e.seeds)))
        playing, at = np.zeros(n, np.int64), np.zeros(n, np.int64)
        begun, busy, over = np.ones(n, bool), np.zeros(n, bool), np.ones(n, bool)
        rewards: list[list[float]] = [[] for _ in range(n)]
        while queue or busy.any():
            begun[:] = over
            for lane in np.flatnonzero(over).tolist():
                busy[lane] = bool(queue)
                playing[lane] = queue.pop(0) if queue else playing[lane]
                at[lane], rewards[lane] = 0, []
            if over.any():
                given = [int(e.seeds[k]) for k in playing]
                seen, _ = envs.reset(seed=given, options={"reset_mask": begun})
                for lane in np.flatnonzero(begun & busy).tolist():
                    self.look(int(playing[lane]), -1, seen[lane])
            rows = np.minimum(self.begins[playing] + at, self.begins[playing + 1] - 1)
            seen, made, terminated, truncated, infos = envs.step(e.actions[rows])
            ends = terminated | truncated
            over[:] = ends
            for lane in np.flatnonzero(busy).tolist():
                k, step = int(playing[lane]), int(at[lane])
                rewards[lane].append(float(made[lane]))
                self._number(k, step, "reward", float(e.rewards[self.begins[k] + step]), rewards[lane][-1])
                self.look(k, step, seen[lane])
                last = step + 1 == int(e.steps[k])
                if last != ends[lane]:
                    words = {True: "over", False: "goes on"}
                    self.note(Difference(k, step, "end of the episode", words[last], words[bool(ends[lane])]), np.inf)
                elif last:
                    self.scores(k, scored(np.array(rewards[lane]), info_of(infos, lane)))
                over[lane] |= last
                busy[lane] = not over[lane]
                if over[lane] and report_progress:
                    report_progress(len(e.seeds) - len(queue) - int(busy.sum()), len(e.seeds))
            at += 1

    def look(self, k: int, step: int, observation: np.ndarray) -> None:
        claimed, found = int(self.e.seen[self.begins[k] + k + step + 1]), digest(observation)
        if claimed != found:
            self.note(Difference(k, step, "digest of the observation", f"{claimed:016x}", f"{found:016x}"), np.nan)

    def scores(self, k: int, found: Mapping[str, float]) -> None:
        if set(found) != set(self.e.scores):
            texts = (", ".join(names) for names in (self.e.scores, found))
            self.note(Difference(k, None, "names of the scores", *texts), np.inf)
            return
        for name, value in found.items():
            self._number(k, None, f"score {name!r}", float(self.e.scores[name][k]), value)

    def _number(self, k: int, step: int | None, what: str, claimed: float, found: float) -> None:
        if np.float64(claimed).tobytes() != np.float64(found).tobytes():
            by = abs(claimed - found)
            self.note(Difference(k, step, what, repr(claimed), repr(found)), np.inf if np.isnan(by) else by)


def _earlier(a: Difference, b: Difference) -> bool:
    """Return whether a comes before b."""

    def place(d: Difference) -> tuple[float, float]:
        return (np.inf if d.episode is None else d.episode, np.inf if d.step is None else d.step)

    return place(a) < place(b)
