"""When one method beats another: interquartile means and bootstrap intervals.

The interquartile mean is that of Agarwal et al. (NeurIPS 2021, rliable). Scores are (runs, episodes): each run of a learner plays
the same test episodes, each of which is a machine of its own. For the interval, whole runs are drawn again with replacement, and
episodes: one training run plays all of its episodes, so its luck is in all of them. Where there is one run, the interval has the
machines alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from registerbench.cards import card_of, seeds
from registerbench.entry_files import Submission
from stage.errors import ArgumentError

DRAWS, LEVEL = 2000, 0.95
NUMBERS = 100_000  # drawn together at most: 800 kB
RUNS = 10  # of a learner, without which it beats nobody
LONG = {"lost_steps": "steps lost", "limits": "limits", "moves": "steps"}
"""Scores of which a long table has the mean of an episode, and what it calls them."""


def iqm(scores: np.ndarray, axis: int | None = None) -> Any:
    """Compute the mean of the middle half of the scores; of fewer than four, of all.

    Args:
        scores: Numbers.
        axis: Along which; None: of all.
    """
    values = np.asarray(scores, float)
    values = np.sort(values.ravel() if axis is None else np.moveaxis(values, axis, -1), axis=-1)
    cut = values.shape[-1] // 4
    middle = values[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return float(middle) if axis is None else middle


def interval(
    scores: np.ndarray,
    draws: int = DRAWS,
    level: float = LEVEL,
    seed: int = 0,
    of: Callable[..., Any] = iqm,
) -> tuple[float, float]:
    """Compute the interval of a figure of scores by the bootstrap.

    Args:
        scores: (runs, episodes).
        draws: Number of samples.
        level: Of the interval, such as 0.95.
        seed: Of the samples.
        of: The figure.

    Returns:
        Both ends.
    """
    scores = np.atleast_2d(np.asarray(scores, float))
    runs, episodes = scores.shape
    which_runs, which_episodes = _drawn(runs, episodes, draws, seed)
    found = np.empty(draws)
    together = max(1, NUMBERS // scores.size)
    for first in range(0, draws, together):
        some = slice(first, first + together)
        values = scores[which_runs[some, :, None], which_episodes[some, None, :]]
        found[some] = of(values.reshape(len(values), -1), axis=1)
    return float(np.quantile(found, 0.5 - level / 2)), float(np.quantile(found, 0.5 + level / 2))


@lru_cache(maxsize=8)  # a table has few shapes
def _drawn(runs: int, episodes: int, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw runs, (draws, runs), and episodes, (draws, episodes)."""
    rng = np.random.default_rng(seed)
    pairs = [(rng.integers(0, episodes, episodes), rng.integers(0, runs, runs)) for _ in range(draws)]
    return np.array([r for _, r in pairs]), np.array([e for e, _ in pairs])


@dataclass(frozen=True)
class Row:
    """A player on a split: IQM of the return (value) and its mean, with their intervals, over `runs` runs.

    success: the share of episodes; regret: its median over those; lost_steps, limits, moves: means of an episode. None where a
    task has none. learned: its cost has moves that it learned from.
    """

    task: str
    split: str
    track: str
    round: str
    player: str
    runs: int
    episodes: int
    value: float
    low: float
    high: float
    mean: float
    mean_low: float
    mean_high: float
    success: float | None
    regret: float | None = None
    lost_steps: float | None = None
    limits: float | None = None
    moves: float | None = None
    learned: bool = False

    @property
    def place(self) -> tuple[str, str, str, str]:
        """Rows of one place stand in one table: task, split, track, round."""
        return self.task, self.split, self.track, self.round

    def beats(self, other: Row) -> bool:
        """Return whether this player beats another: the intervals of the IQM do not overlap, and a learner has RUNS runs.

        Args:
            other: Row of the same place.
        """
        parted = self.place == other.place and self.low > other.high
        return parted and (self.runs >= RUNS or not self.learned)

    def cells(self, others: Iterable[Row], long: bool) -> list[str]:
        """Return the cells of a table.

        Args:
            others: Rows of the same place.
            long: With regret and more.
        """
        names = [f"{o.player}{' (lower in the mean)' * (self.mean < o.mean)}" for o in others if self.beats(o)]
        beaten = ", ".join(names) or "-"
        if self.learned and self.runs < RUNS:
            beaten = f"too few runs: {RUNS} are asked"
        more = [_said(self.regret, ".3f"), *(_said(getattr(self, name), ".1f") for name in LONG)]
        return [
            self.player,
            f"{self.runs} x {self.episodes}",
            f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})",
            f"{self.mean:.3f} ({self.mean_low:.3f} to {self.mean_high:.3f})",
            _said(self.success, ".0%"),
            *(more if long else ()),
            beaten,
        ]


def _said(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def rows(entries: Iterable[Submission]) -> list[Row]:
    """Return a row for each task, split, track, round and player, the best first.

    Args:
        entries: To compare.

    Raises:
        ArgumentError: An entry lacks test episodes of its round, or a player's run is there twice.
    """
    groups: dict[tuple[str, str, str, str, str], list[Submission]] = {}
    for e in entries:
        _whole(e)
        groups.setdefault((e.task, e.split, e.track, e.round, e.player), []).append(e)
    found = [_row(some) for some in groups.values()]
    return sorted(found, key=lambda r: (*r.place, -r.value))


def _whole(e: Submission) -> None:
    """Raise ArgumentError for an entry that can stand in no table."""
    wanted, given = seeds(card_of(e.task), e.split, e.round), list(e.seeds)
    if given != wanted:
        part = given == wanted[: len(given)]
        what = f"{len(given)} of the {len(wanted)}" if part else "others than the"
        raise ArgumentError(
            f"{e.player} on {e.task} {e.split}, run {e.run}: it has {what} test episodes of the round {e.round!r}, and can stand "
            "in no table; leave its file out."
        )


def _row(some: list[Submission]) -> Row:
    """Return the row of the runs of a player."""
    e = some[0]
    if len({e.run for e in some}) < len(some):
        raise ArgumentError(
            f"{e.player} on {e.task} {e.split}: two entries are of the same run; give --run to bench-submit."
        )

    def of(name: str) -> np.ndarray | None:
        return np.array([e.scores[name] for e in some]) if all(name in e.scores for e in some) else None

    def mean(name: str) -> float | None:
        values = of(name)
        return None if values is None else float(values.mean())

    scores, regret = np.array([e.scores["return"] for e in some]), of("regret")
    known = np.array([]) if regret is None else regret[np.isfinite(regret)]
    low, high = interval(scores)
    mean_low, mean_high = interval(scores, of=np.mean)
    return Row(
        task=e.task, split=e.split, track=e.track, round=e.round, player=e.player, runs=scores.shape[0], episodes=scores.shape[1],
        value=iqm(scores), low=low, high=high, mean=float(scores.mean()), mean_low=mean_low, mean_high=mean_high,
        success=mean("success"), regret=float(np.median(known)) if len(known) else None,
        lost_steps=mean("lost_steps"), limits=mean("limits"), moves=mean("moves"),
        learned=any(e.cost.get("moves", 0) > 0 for e in some),
    )  # fmt: skip


def table(entries: Iterable[Submission], long: bool = False) -> str:
    """Write a Markdown table for each task, split, track and round; its last column names whom a player beats.

    Args:
        entries: To compare.
        long: With regret and more columns.
    """
    lines: list[str] = []
    every = rows(entries)
    heads = ["player", "runs x episodes", "IQM of the return (95 %)", "mean (95 %)", "success"]
    heads += [*(["regret", *LONG.values()] if long else []), "beats"]
    for place in dict.fromkeys(r.place for r in every):
        some = [r for r in every if r.place == place]
        task, split, track, round_ = place
        lines += [f"**{task}, {split}, round {round_}** (track {track})", ""]
        lines += [_line(heads), "|---" * len(heads) + "|", *(_line(r.cells(some, long)) for r in some), ""]
    return "\n".join(lines).rstrip()


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
