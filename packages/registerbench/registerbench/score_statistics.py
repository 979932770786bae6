"""Interquartile means and bootstrap intervals, which decide whether one method beats another.

The interquartile mean (IQM) is that of Agarwal et al. (NeurIPS 2021, rliable). Scores are arrays (runs, episodes): each run of a
learner plays the same test episodes, and each episode has its own machine. The bootstrap draws whole runs and whole episodes
with replacement, because all episodes of a training run depend on its luck. The interval of a single run reflects only the
spread over machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from registerbench.benchmark_tasks import find_card, list_test_seeds
from registerbench.entry_files import Entry
from stage.errors import ArgumentError

BOOTSTRAP_SAMPLES, CONFIDENCE_LEVEL = 2000, 0.95
MAX_NUMBERS_AT_ONCE = 100_000  # of one batch of bootstrap samples: 800 kB
MIN_LEARNER_RUNS = 10  # a learner with fewer training runs beats nobody
LONG_TABLE_SCORES = {"lost_steps": "steps lost", "limits": "limits", "moves": "steps"}
"""Scores whose mean over the episodes stands in a long table, and the heading of each column."""


def compute_iqm(scores: np.ndarray, axis: int | None = None) -> Any:
    """Compute the interquartile mean: the mean of the middle half of the scores, or of all scores if there are fewer than four.

    Args:
        scores: Numbers.
        axis: Axis along which to compute the mean; None: of all scores.
    """
    values = np.asarray(scores, float)
    values = np.sort(values.ravel() if axis is None else np.moveaxis(values, axis, -1), axis=-1)
    cut = values.shape[-1] // 4
    middle = values[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return float(middle) if axis is None else middle


def compute_interval(
    scores: np.ndarray,
    draws: int = BOOTSTRAP_SAMPLES,
    level: float = CONFIDENCE_LEVEL,
    seed: int = 0,
    statistic: Callable[..., Any] = compute_iqm,
) -> tuple[float, float]:
    """Compute the confidence interval of a statistic of the scores by the bootstrap.

    Args:
        scores: Scores, (runs, episodes).
        draws: Number of bootstrap samples.
        level: Confidence level, such as 0.95.
        seed: Seed of the bootstrap samples.
        statistic: Function of scores and axis, such as `compute_iqm`.

    Returns:
        Lower and upper end of the interval.
    """
    scores = np.atleast_2d(np.asarray(scores, float))
    runs, episodes = scores.shape
    which_runs, which_episodes = _draw_bootstrap_indices(runs, episodes, draws, seed)
    figures = np.empty(draws)
    batch_size = max(1, MAX_NUMBERS_AT_ONCE // scores.size)
    for first in range(0, draws, batch_size):
        batch = slice(first, first + batch_size)
        values = scores[which_runs[batch, :, None], which_episodes[batch, None, :]]
        figures[batch] = statistic(values.reshape(len(values), -1), axis=1)
    return float(np.quantile(figures, 0.5 - level / 2)), float(np.quantile(figures, 0.5 + level / 2))


@lru_cache(maxsize=8)  # a table has few shapes
def _draw_bootstrap_indices(runs: int, episodes: int, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw the indices of runs, (draws, runs), and of episodes, (draws, episodes)."""
    rng = np.random.default_rng(seed)
    pairs = [(rng.integers(0, episodes, episodes), rng.integers(0, runs, runs)) for _ in range(draws)]
    return np.array([r for _, r in pairs]), np.array([e for e, _ in pairs])


@dataclass(frozen=True)
class ScoreRow:
    """Scores of a player on a split, over all of its runs.

    Attributes:
        task, split, track, round: What was played.
        player: Name of the player.
        runs: Number of training runs.
        episodes: Number of test episodes of a run.
        value, low, high: IQM of the return with its interval.
        mean, mean_low, mean_high: Mean of the return with its interval.
        success: Share of the episodes that succeeded; None if the task does not define success.
        regret: Median of the regret over the episodes that have one.
        lost_steps, limits, moves: Means over the episodes; None if the task does not count them.
        learned: Whether the player states that it made moves to learn from.
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
    def table_key(self) -> tuple[str, str, str, str]:
        """Task, split, track and round; rows with the same four stand in one table."""
        return self.task, self.split, self.track, self.round

    def beats(self, other: ScoreRow) -> bool:
        """Return whether this player beats another: its interval of the IQM lies above, and a learner has MIN_LEARNER_RUNS runs.

        Args:
            other: Row of the same task, split, track and round.
        """
        is_above = self.table_key == other.table_key and self.low > other.high
        return is_above and (self.runs >= MIN_LEARNER_RUNS or not self.learned)

    def format_cells(self, others: Iterable[ScoreRow], long: bool) -> list[str]:
        """Format the cells of this row of a table.

        Args:
            others: All rows of the table.
            long: Whether the table has the columns regret, lost steps, limits and steps.
        """
        names = [
            f"{other.player}{' (lower in the mean)' * (self.mean < other.mean)}"
            for other in others
            if self.beats(other)
        ]
        beaten = ", ".join(names) or "-"
        if self.learned and self.runs < MIN_LEARNER_RUNS:
            beaten = f"too few runs: {MIN_LEARNER_RUNS} are needed"
        more = [
            _format_or_dash(self.regret, ".3f"),
            *(_format_or_dash(getattr(self, name), ".1f") for name in LONG_TABLE_SCORES),
        ]
        return [
            self.player,
            f"{self.runs} x {self.episodes}",
            f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})",
            f"{self.mean:.3f} ({self.mean_low:.3f} to {self.mean_high:.3f})",
            _format_or_dash(self.success, ".0%"),
            *(more if long else ()),
            beaten,
        ]


def _format_or_dash(value: float | None, form: str) -> str:
    """Format a number, or return a dash for None."""
    return "-" if value is None else format(value, form)


def compute_rows(entries: Iterable[Entry]) -> list[ScoreRow]:
    """Compute a row for each task, split, track, round and player, sorted by the IQM of the return, the best first.

    Args:
        entries: Entries to compare.

    Raises:
        ArgumentError: An entry lacks test episodes of its round, or two entries hold the same run of a player.
    """
    groups: dict[tuple[str, str, str, str, str], list[Entry]] = {}
    for e in entries:
        _require_all_test_episodes(e)
        groups.setdefault((e.task, e.split, e.track, e.round, e.player), []).append(e)
    rows_ = [_compute_row(runs) for runs in groups.values()]
    return sorted(rows_, key=lambda r: (*r.table_key, -r.value))


def _require_all_test_episodes(e: Entry) -> None:
    """Raise ArgumentError for an entry that lacks test episodes of its round, and so can stand in no table."""
    wanted, played = list_test_seeds(find_card(e.task), e.split, e.round), list(e.seeds)
    if played != wanted:
        part = played == wanted[: len(played)]
        what = f"{len(played)} of the {len(wanted)}" if part else "others than the"
        raise ArgumentError(
            f"{e.player} on {e.task} {e.split}, run {e.run}: the entry has {what} test episodes of the round {e.round!r}, and can "
            "stand in no table; leave its file out."
        )


def _compute_row(runs: list[Entry]) -> ScoreRow:
    """Compute the row of a player from the entries of its runs."""
    e = runs[0]
    if len({e.run for e in runs}) < len(runs):
        raise ArgumentError(
            f"{e.player} on {e.task} {e.split}: two entries hold the same run; give each its number by --run of bench-submit."
        )

    def stack_scores(name: str) -> np.ndarray | None:
        """Return a score of all runs, (runs, episodes); None if an entry lacks it."""
        return np.array([e.scores[name] for e in runs]) if all(name in e.scores for e in runs) else None

    def compute_mean(name: str) -> float | None:
        """Return the mean of a score over all runs and episodes; None if an entry lacks it."""
        values = stack_scores(name)
        return None if values is None else float(values.mean())

    scores, regret = np.array([e.scores["return"] for e in runs]), stack_scores("regret")
    known = np.array([]) if regret is None else regret[np.isfinite(regret)]
    low, high = compute_interval(scores)
    mean_low, mean_high = compute_interval(scores, statistic=np.mean)
    return ScoreRow(
        task=e.task, split=e.split, track=e.track, round=e.round, player=e.player, runs=scores.shape[0], episodes=scores.shape[1],
        value=compute_iqm(scores), low=low, high=high, mean=float(scores.mean()), mean_low=mean_low, mean_high=mean_high,
        success=compute_mean("success"), regret=float(np.median(known)) if len(known) else None,
        lost_steps=compute_mean("lost_steps"), limits=compute_mean("limits"), moves=compute_mean("moves"),
        learned=any(e.cost.get("moves", 0) > 0 for e in runs),
    )  # fmt: skip


def format_tables(entries: Iterable[Entry], long: bool = False) -> str:
    """Format a Markdown table for each task, split, track and round; its last column names the players that a player beats.

    Args:
        entries: Entries to compare.
        long: Whether to add the columns regret, lost steps, limits and steps.
    """
    lines: list[str] = []
    all_rows = compute_rows(entries)
    heads = ["player", "runs x episodes", "IQM of the return (95 %)", "mean (95 %)", "success"]
    heads += [*(["regret", *LONG_TABLE_SCORES.values()] if long else []), "beats"]
    for key in dict.fromkeys(r.table_key for r in all_rows):
        group = [r for r in all_rows if r.table_key == key]
        task, split, track, round_ = key
        lines += [f"**{task}, {split}, round {round_}** (track {track})", ""]
        lines += [
            _format_row(heads),
            "|---" * len(heads) + "|",
            *(_format_row(r.format_cells(group, long)) for r in group),
            "",
        ]
    return "\n".join(lines).rstrip()


def _format_row(cells: Iterable[str]) -> str:
    """Format a row of a Markdown table."""
    return f"| {' | '.join(cells)} |"
