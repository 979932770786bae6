"""When one method beats another: interquartile means and stratified bootstrap intervals.

As Agarwal et al. (NeurIPS 2021, rliable) have them. Scores are (runs, episodes): each run of a learner plays the same test
episodes, each of which is a machine of its own. The middle half of all scores is averaged. For the interval, episodes are drawn
again with replacement, and for each of them the runs: so it has what comes of the machines that were tested, and of the learner's
chance. Where there is one run, it has the machines alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stage.bench.files import Submission
from stage.errors import ArgumentError

DRAWS, LEVEL = 2000, 0.95
RUNS = 10  # of a learner, without which it beats nobody


def iqm(scores: np.ndarray) -> float:
    """The mean of the middle half of all numbers; of fewer than four, of all."""
    values = np.sort(np.asarray(scores, float), axis=None)
    cut = len(values) // 4
    return float(values[cut : len(values) - cut].mean())


def interval(scores: np.ndarray, draws: int = DRAWS, level: float = LEVEL, seed: int = 0) -> tuple[float, float]:
    """Of the IQM of scores, (runs, episodes), by the bootstrap."""
    scores = np.atleast_2d(np.asarray(scores, float))
    runs, episodes = scores.shape
    rng = np.random.default_rng(seed)
    found = np.empty(draws)
    for k in range(draws):
        columns = rng.integers(0, episodes, episodes)
        found[k] = iqm(scores[rng.integers(0, runs, (runs, episodes)), columns])
    return float(np.quantile(found, 0.5 - level / 2)), float(np.quantile(found, 0.5 + level / 2))


@dataclass(frozen=True)
class Row:
    """A player on a split: IQM of the return with its interval, over `runs` runs.

    success: the share of episodes; None where a task has none. learned: its cost has moves that it learned from.
    """

    task: str
    split: str
    track: str
    player: str
    runs: int
    episodes: int
    value: float
    low: float
    high: float
    success: float | None
    learned: bool = False

    def beats(self, other: Row) -> bool:
        """The intervals part, and this is the higher. A learner needs RUNS runs to say so."""
        return self.low > other.high and (self.runs >= RUNS or not self.learned)


def rows(entries: Iterable[Submission]) -> list[Row]:
    """A row for each task, split, track and player, the best first. Raises ArgumentError where entries of a player are not of the
    same episodes, or are the same run twice."""
    groups: dict[tuple[str, str, str, str, str], list[Submission]] = {}
    for e in entries:
        groups.setdefault((e.task, e.split, e.track, e.round, e.player), []).append(e)
    found = []
    for (task, split, track, _, player), some in groups.items():
        if len({e.seeds for e in some}) > 1:
            raise ArgumentError(f"{player} on {task} {split}: its entries have different test episodes.")
        if len({e.run for e in some}) < len(some):
            raise ArgumentError(
                f"{player} on {task} {split}: two entries are of the same run; give --run to bench-submit."
            )
        scores = np.array([e.scores["return"] for e in some])
        success = [e.scores["success"] for e in some if "success" in e.scores]
        share = float(np.mean(success)) if success else None
        runs, episodes = scores.shape
        low, high = interval(scores)
        learned = any(e.cost.get("moves", 0) > 0 for e in some)
        found.append(Row(task, split, track, player, runs, episodes, iqm(scores), low, high, share, learned))
    return sorted(found, key=lambda r: (r.task, r.split, r.track, -r.value))


def table(entries: Iterable[Submission]) -> str:
    """Markdown, a table for each task and split; the last column names whom a player beats: whose intervals lie below its own."""
    lines: list[str] = []
    every = rows(entries)
    for place in dict.fromkeys((r.task, r.split, r.track) for r in every):
        some = [r for r in every if (r.task, r.split, r.track) == place]
        lines += [f"**{place[0]}, {place[1]}** (track {place[2]})", ""]
        lines += [
            "| player | runs x episodes | IQM of the return | 95 % | success | beats |",
            "|---|---|---|---|---|---|",
        ]
        for r in some:
            beaten = ", ".join(o.player for o in some if r.beats(o)) or "-"
            if r.learned and r.runs < RUNS:
                beaten = f"too few runs: {RUNS} are asked"
            success = "-" if r.success is None else f"{r.success:.0%}"
            lines.append(
                f"| {r.player} | {r.runs} x {r.episodes} | {r.value:.3f} | {r.low:.3f} to {r.high:.3f} | {success} | {beaten} |"
            )
        lines.append("")
    return "\n".join(lines).rstrip()
