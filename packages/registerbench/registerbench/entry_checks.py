"""Checks of entries before they are compared: replay, copies, shipped players, and training runs that are made again.

Nothing that an entry claims counts: its rewards come from a replay, runs that do the same are copies, and a player counts as
one that does not learn only if it is shipped and plays all of these actions again. A learner's run counts if its training
command, run again, gives its actions again; `spot_checks` says for how many runs of each player this is tried. Commands come
from the authors of entries, so none is run unless the caller asks for it.
"""

from __future__ import annotations

import hashlib
import secrets
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from registerbench import entry_creation, entry_files, entry_replay
from registerbench.benchmark_tasks import find_card, list_test_seeds
from registerbench.entry_files import Entry
from registerbench.shipped_policies import COMMON_PLAYERS, TASK_PLAYERS
from stage.errors import ArgumentError, StageError

TRAINING_TIME_LIMIT_S = 24 * 3600.0
MAX_STANDARD_ERRORS = 3.0  # by which the mean of a run may be lower in a new round
EQUAL_RETURN = 1e-3  # returns that differ by less are equal: the last digit of the tables
MAX_EQUAL_SHARE = 0.5  # of the solved episodes; different runs of learners have equal returns in up to 0.12 of them


@dataclass(frozen=True)
class EntryCheck:
    """Result of the checks of one benchmark entry.

    Attributes:
        replayed: Whether a replay has confirmed every reward, observation and score.
        shipped: Whether a shipped player of this name plays its actions again, so that nothing was learned.
        misnamed: Whether it has the name of a shipped player, which does not play its actions.
        retrained: Whether its training command gave its actions again; None if that was not tried.
        note: Reason of a check that failed, in words; "" if none failed.
    """

    replayed: bool = False
    shipped: bool = False
    misnamed: bool = False
    retrained: bool | None = None
    note: str = ""


def digest_actions(e: Entry) -> str:
    """Return a digest of what an entry did; two runs with the same digest are copies."""
    digest = hashlib.blake2b(np.ascontiguousarray(e.actions).tobytes(), digest_size=16)
    digest.update(np.ascontiguousarray(e.steps).tobytes())
    return digest.hexdigest()


def select_different_runs(runs: Iterable[Entry]) -> list[Entry]:
    """Return the runs of a player without copies: each differs from all others that are returned, see `is_copy`."""
    different: list[Entry] = []
    for run in runs:
        if not any(is_copy(run, other) for other in different):
            different.append(run)
    return different


def is_copy(e: Entry, other: Entry) -> bool:
    """Return whether two runs of a task do the same: their actions are equal, or most of what they solve ends with equal returns.

    A copy may have other actions that change nothing, such as the address of a wait, or a rate that differs by its last bit.
    Episodes of which neither run gains anything do not count, because failures cost the same.

    Args:
        e: Entry of a run.
        other: Entry of another run of the same episodes.
    """
    if digest_actions(e) == digest_actions(other):
        return True
    returns, others = e.scores["return"], other.scores["return"]
    gained = np.maximum(returns, others) > EQUAL_RETURN
    for scores in (e.scores, other.scores):
        gained &= scores.get("success", np.ones(len(returns))) > 0
    return bool(gained.any()) and float((np.abs(returns - others) < EQUAL_RETURN)[gained].mean()) > MAX_EQUAL_SHARE


def check_entries(
    entries: Iterable[Entry],
    replay: bool = True,
    spot_checks: int = 0,
    report_progress: Callable[[str], None] = lambda text: None,
    new_round: bool = False,
) -> list[EntryCheck]:
    """Check entries of the benchmark by replaying them and comparing them with each other.

    Args:
        entries: Entries to check.
        replay: Whether to replay them; otherwise no entry counts as replayed.
        spot_checks: Number of runs of each player whose training commands are run again, drawn at random.
        report_progress: Called with a sentence before each step that takes long.
        new_round: Whether these commands are run once more, on a round whose word is drawn now.

    Returns:
        A check of each entry, in their order.
    """
    if isinstance(spot_checks, bool) or not isinstance(spot_checks, int) or spot_checks < 0:
        raise ArgumentError(f"spot_checks={spot_checks!r}: a whole number of runs, 0 or more.")
    entries = list(entries)
    checks = [_check_replay(e, report_progress) if replay else EntryCheck(note="not replayed") for e in entries]
    for indices in _group_runs(entries, checks):
        drawn_indices = np.random.default_rng().permutation(indices)[:spot_checks]  # nobody can know which
        for k in drawn_indices.tolist():
            report_progress(f"trains {_describe(entries[k])} again: {entries[k].training}")
            checks[k] = _retrain(entries[k], checks[k], new_round)
    return checks


def _describe(e: Entry) -> str:
    """Return player, task, split and run of a benchmark entry in words."""
    return f"{e.player} on {e.task} {e.split}, run {e.run}"


def _check_replay(e: Entry, report_progress: Callable[[str], None]) -> EntryCheck:
    """Replay an entry, and play the shipped player of its name again."""
    report_progress(f"replays {_describe(e)}")
    is_shipped_name = e.player in {**COMMON_PLAYERS, **TASK_PLAYERS.get(e.task, {})}
    try:
        verdict = entry_replay.verify(e)
        if not verdict.exact:
            return EntryCheck(misnamed=is_shipped_name, note=f"differs here: {verdict.first_difference}")
        shipped = is_shipped_name and _is_played_again(e)
        return EntryCheck(replayed=True, shipped=shipped, misnamed=is_shipped_name and not shipped)
    except StageError as why:
        return EntryCheck(misnamed=is_shipped_name, note=str(why))


def _is_played_again(e: Entry) -> bool:
    """Return whether the shipped player of an entry's name makes all of its actions again."""
    again = entry_creation.play(
        e.player, e.task, e.split, track=e.track, round_=e.round, settings=e.settings, run=e.run, episodes=len(e.seeds)
    )
    return digest_actions(again) == digest_actions(e)


def _group_runs(entries: list[Entry], checks: list[EntryCheck]) -> list[list[int]]:
    """Group the replayed runs of each player that the package does not ship; return the indices of each group."""
    groups: dict[tuple, list[int]] = {}
    for k, (e, check) in enumerate(zip(entries, checks, strict=True)):
        if check.replayed and not check.shipped:
            groups.setdefault((e.task, e.split, e.track, e.round, e.player), []).append(k)
    return list(groups.values())


def _retrain(e: Entry, check: EntryCheck, new_round: bool) -> EntryCheck:
    """Run the training command of an entry, and compare the actions of the entry that it writes.

    Args:
        e: Entry of a run.
        check: Check of the entry so far.
        new_round: Whether to run the command once more on a new round, of which it cannot repeat stored actions.
    """
    if not e.training:
        return replace(check, retrained=False, note=f"run {e.run} states no training command")
    try:
        again = _run_training_command(e, e.round)
        if again.seeds != e.seeds or digest_actions(again) != digest_actions(e):
            note = f"the training command of run {e.run} gives other actions"
        elif new_round:
            note = _explain_new_round_failure(e, f"new-{secrets.token_hex(8)}")
        else:
            note = ""
    except (OSError, subprocess.SubprocessError, StageError) as why:
        note = f"the training command of run {e.run} failed: {str(why)[:200]}"
    return replace(check, retrained=not note, note=note)


def _run_training_command(e: Entry, round_: str) -> Entry:
    """Run the training command of an entry for a round, and return the entry that it writes. Raises errors of the command."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "again.bench"
        values = {"{run}": str(e.run), "{task}": e.task, "{split}": e.split, "{round}": round_, "{out}": str(file)}
        words = [sys.executable if word == "python" else word for word in shlex.split(e.training)]
        words = [_fill_in(word, values) for word in words]
        subprocess.run(words, check=True, capture_output=True, timeout=TRAINING_TIME_LIMIT_S)
        return entry_files.read_entry(file)


def _explain_new_round_failure(e: Entry, word: str) -> str:
    """Run the training command of an entry on a new round, and explain why its result is no round of that player; "" if it is.

    Args:
        e: Entry of a run.
        word: Word of the new round.
    """
    again = _run_training_command(e, word)
    seeds = list_test_seeds(find_card(e.task), e.split, word)
    played = again.task, again.split, again.track, again.round, list(again.seeds)
    if played != (e.task, e.split, e.track, word, seeds):
        return f"the training command of run {e.run} does not play a new round"
    if not entry_replay.verify(again).exact:
        return f"the training command of run {e.run} writes an entry that differs here"
    old, new = e.scores["return"], again.scores["return"]
    error = float(np.sqrt(old.var() / len(old) + new.var() / len(new)))
    if old.mean() - new.mean() > MAX_STANDARD_ERRORS * error + EQUAL_RETURN:
        return f"run {e.run} is worse in a new round: {new.mean():.3f} in place of {old.mean():.3f}"
    return ""


def _fill_in(word: str, values: dict[str, str]) -> str:
    """Replace the names in braces in a word of a training command by their values."""
    for name, value in values.items():
        word = word.replace(name, value)
    return word
