"""Interquartile means and bootstrap intervals, which decide whether one method beats another.

The interquartile mean (IQM) is that of Agarwal et al. (NeurIPS 2021, rliable). Scores are arrays (runs, episodes): each run of a
learner plays the same test episodes, and each episode has its own machine. The bootstrap draws whole runs and whole episodes
with replacement, because all episodes of a training run depend on its luck. The interval of a single run reflects only the
spread over machines. Comparisons are paired: all players play the same machines, so a draw has the same episodes of both, and the
interval is that of the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from registerbench.benchmark_tasks import find_card, list_test_seeds
from registerbench.entry_checks import EntryCheck, select_different_runs
from registerbench.entry_files import Entry
from registerbench.shipped_policies import REFERENCES
from stage.errors import ArgumentError

BOOTSTRAP_SAMPLES, CONFIDENCE_LEVEL = 2000, 0.95
MAX_NUMBERS_AT_ONCE = 100_000  # of one batch of bootstrap samples: 800 kB
MIN_LEARNER_RUNS = 10  # a learner with fewer training runs beats nobody
ORACLE, ORACLE_TRACK = "oracle", "truth"  # the player that searches on the true machine, and its track
UNCONFIRMED = "(not confirmed)"  # follows the name of a shipped player that has not made the actions
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


def compute_difference(
    scores: np.ndarray, others: np.ndarray, draws: int = BOOTSTRAP_SAMPLES
) -> tuple[float, float, float]:
    """Compute by how much one player is better than another on the same machines: the difference of their IQMs.

    Args:
        scores: Scores of the player, (runs, episodes).
        others: Scores of the other player, (runs, episodes), of the same episodes.
        draws: Number of bootstrap samples; each has the same episodes of both players.

    Returns:
        The difference, and both ends of its interval.
    """
    rng = np.random.default_rng(0)
    episodes = rng.integers(0, scores.shape[1], (draws, 1, scores.shape[1]))
    figures = []
    for values in (scores, others):
        runs = rng.integers(0, len(values), (draws, len(values), 1))
        figures.append(compute_iqm(values[runs, episodes].reshape(draws, -1), axis=1))
    low, high = np.quantile(figures[0] - figures[1], [0.5 - CONFIDENCE_LEVEL / 2, 0.5 + CONFIDENCE_LEVEL / 2])
    return compute_iqm(scores) - compute_iqm(others), float(low), float(high)


def get_reference(task: str) -> str:
    """Return the name of the shipped player to which others of a task are compared."""
    return REFERENCES.get(task, "scripted")


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
        learned: Whether the player may have learned: it is not shipped, or does other things than the shipped one.
        replayed: Whether a replay has confirmed all of its entries.
        retrained: Whether the training commands that were tried gave their actions again; None if none was tried.
        copies: Number of entries that were left out because another run does the same.
        skipped_runs: Number of runs below the highest number that have no entry.
        note: Reason of a check that failed, in words; "" if none failed.
        normalized: IQM on the scale on which the reference is 0 and the oracle 1; None if the table lacks one of them.
        difference, difference_low, difference_high: IQM minus that of the reference on the same machines, with its interval.
        scores: Returns, (runs, episodes).
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
    replayed: bool = True
    retrained: bool | None = True
    copies: int = 0
    skipped_runs: int = 0
    note: str = ""
    normalized: float | None = None
    difference: float | None = None
    difference_low: float | None = None
    difference_high: float | None = None
    scores: Any = field(default=None, repr=False, compare=False)

    def json(self) -> dict[str, Any]:
        """Return the row as `stage bench-table --json` prints it."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "scores"}

    @property
    def doubt(self) -> str:
        """Reason for which this row beats nobody, in words; "" if there is none."""
        if not self.replayed:
            return f"not replayed: {self.note}" if self.note and self.note != "not replayed" else "not replayed"
        if self.learned and self.runs < MIN_LEARNER_RUNS:
            return f"too few runs: {MIN_LEARNER_RUNS} are needed"
        if self.skipped_runs:
            return f"runs are missing: {self.skipped_runs} below the highest number"
        if self.learned and not self.retrained:
            return self.note or "not trained again: see --spot-check"
        return ""

    @property
    def table_key(self) -> tuple[str, str, str, str]:
        """Task, split, track and round; rows with the same four stand in one table."""
        return self.task, self.split, self.track, self.round

    def beats(self, other: ScoreRow) -> bool:
        """Return whether this player beats another without doubt.

        It does if the whole interval of the difference of their IQMs on the same machines is above 0, its row has no doubt, and
        the scores of the other one are confirmed, too.

        Args:
            other: Row of the same task, split, track and round.
        """
        if self.table_key != other.table_key or self.doubt or not other.replayed:
            return False
        return compute_difference(self.scores, other.scores)[1] > 0

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
        beaten = self.doubt or ", ".join(names) or "-"
        difference = "-"
        if self.difference is not None:
            difference = f"{self.difference:+.3f} ({self.difference_low:+.3f} to {self.difference_high:+.3f})"
        more = [
            _format_or_dash(self.regret, ".3f"),
            *(_format_or_dash(getattr(self, name), ".1f") for name in LONG_TABLE_SCORES),
        ]
        return [
            self.player,
            f"{self.runs} x {self.episodes}{f', {self.copies} copies left out' * bool(self.copies)}",
            f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})",
            f"{self.mean:.3f} ({self.mean_low:.3f} to {self.mean_high:.3f})",
            difference,
            _format_or_dash(self.normalized, ".2f"),
            _format_or_dash(self.success, ".0%"),
            *(more if long else ()),
            beaten,
        ]


def _format_or_dash(value: float | None, form: str) -> str:
    """Format a number, or return a dash for None."""
    return "-" if value is None else format(value, form)


def compute_rows(entries: Iterable[Entry], checks: Sequence[EntryCheck] | None = None) -> list[ScoreRow]:
    """Compute a row for each task, split, track, round and player. The best by the IQM is first, what is not replayed last.

    Args:
        entries: Entries to compare.
        checks: Checks of the entries, see `check_entries`; None: trust what the entries state.

    Raises:
        ArgumentError: An entry lacks test episodes of its round, or two entries hold the same run of a player.
    """
    groups: dict[tuple[str, str, str, str, str], list[tuple[Entry, EntryCheck | None]]] = {}
    for k, e in enumerate(entries):
        _require_all_test_episodes(e)
        check = None if checks is None else checks[k]
        if check is not None and check.misnamed:  # it is no run of the shipped player, and never the reference
            e = replace(e, player=f"{e.player} {UNCONFIRMED}")
        groups.setdefault((e.task, e.split, e.track, e.round, e.player), []).append((e, check))
    rows = _add_comparisons([_compute_row(runs) for runs in groups.values()])
    return sorted(rows, key=lambda r: (*r.table_key, not r.replayed, -r.value))


def _add_comparisons(rows: list[ScoreRow]) -> list[ScoreRow]:
    """Add the difference to the reference and the normalized score to each row."""
    known = {(*row.table_key, row.player): row for row in rows if row.replayed}
    compared = []
    for row in rows:
        reference = known.get((*row.table_key, get_reference(row.task)))
        if reference is not None and row is not reference:
            difference, low, high = compute_difference(row.scores, reference.scores)
            row = replace(row, difference=difference, difference_low=low, difference_high=high)
        base = known.get((row.task, row.split, "host", row.round, get_reference(row.task)))
        oracle = known.get((row.task, row.split, ORACLE_TRACK, row.round, ORACLE))
        if base is not None and oracle is not None and oracle.value > base.value:
            row = replace(row, normalized=(row.value - base.value) / (oracle.value - base.value))
        compared.append(row)
    return compared


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


def _compute_row(checked_runs: list[tuple[Entry, EntryCheck | None]]) -> ScoreRow:
    """Compute the row of a player from the entries of its runs, each with its check."""
    runs, checks = [e for e, _ in checked_runs], [check for _, check in checked_runs if check is not None]
    e = runs[0]
    if len({e.run for e in runs}) < len(runs):
        raise ArgumentError(
            f"{e.player} on {e.task} {e.split}: two entries hold the same run; give each its number by --run of bench-submit."
        )

    entered, highest_run = len(runs), max(e.run for e in runs)
    if checks:
        runs = select_different_runs(runs)
    learned, replayed = any(run.cost.get("moves", 0) > 0 for run in runs), True
    retrained: bool | None = True
    if checks:
        is_oracle = (e.player, e.track) == (ORACLE, ORACLE_TRACK)  # it has no opponents
        learned = not is_oracle and not all(check.shipped for check in checks)
        replayed = all(check.replayed for check in checks)
        tried = [check.retrained for check in checks if check.retrained is not None]
        retrained = all(tried) if tried else None

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
        learned=learned, replayed=replayed, retrained=retrained, copies=entered - len(runs),
        skipped_runs=highest_run + 1 - entered,
        note=next((check.note for check in checks if check.note), ""), scores=scores,
    )  # fmt: skip


def format_tables(entries: Iterable[Entry], long: bool = False) -> str:
    """Format a Markdown table for each task, split, track and round; its last column names the players that a player beats.

    Args:
        entries: Entries to compare.
        long: Whether to add the columns regret, lost steps, limits and steps.
    """
    return format_rows(compute_rows(entries), long)


def format_rows(rows: Sequence[ScoreRow], long: bool = False) -> str:
    """Format rows as tables, see `format_tables`. A table of the track host shows the oracle, which then has no other table."""
    lines: list[str] = []
    keys = dict.fromkeys(r.table_key for r in rows)
    for key in keys:
        task, split, track, round_ = key
        group = [r for r in rows if r.table_key == key]
        has_host_table = track == ORACLE_TRACK and (task, split, "host", round_) in keys
        if has_host_table and all(r.player == ORACLE and r.replayed for r in group):
            continue
        oracle = (task, split, ORACLE_TRACK, round_)
        extra = [r for r in rows if track == "host" and r.table_key == oracle and r.player == ORACLE and r.replayed]
        heads = [
            "player",
            "runs x episodes",
            "IQM of the return (95 %)",
            "mean (95 %)",
            f"IQM minus {get_reference(task)}, paired",
        ]
        heads += ["of oracle", "success", *(["regret", *LONG_TABLE_SCORES.values()] if long else []), "beats"]
        lines += [f"**{task}, {split}, round {round_}** (track {track})", ""]
        lines += [
            _format_row(heads),
            "|---" * len(heads) + "|",
            *(_format_row(r.format_cells(group, long)) for r in [*extra, *group]),
            "",
        ]
    return "\n".join(lines).rstrip()


def _format_row(cells: Iterable[str]) -> str:
    """Format a row of a Markdown table. The name of a player makes no cells or tags."""
    escaped = [cell.replace("|", "\\|").replace("<", "\\<") for cell in cells]
    return f"| {' | '.join(escaped)} |"
