"""Tests of docs/data: every archive in entries/ can be replayed, and the page's tables follow from what is published."""

import csv
import dataclasses
import itertools
from pathlib import Path

import pytest

import registerbench
from registerbench import score_statistics
from registerbench.entry_checks import EntryCheck
from registerbench.entry_files import Entry
from registerbench.package_versions import list_versions
from registerbench.shipped_policies import COMMON_PLAYERS, TASK_PLAYERS

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "benchmark.md").read_text()
PHYSICS = "physics"
VERSIONS_OF_BITS = ("mujoco", "numpy", "system", PHYSICS)
"""Versions that must be equal for an entry to be replayed bit for bit."""
FEW_EPISODES = 2


@pytest.fixture(scope="module")
def entries():
    """Return the published entries by archive and file name."""
    archives = sorted((DOCS / "data" / "entries").glob("*.zip"))
    return {(path.stem, name): e for path in archives for name, e in registerbench.read_entries(path).items()}


def is_learned(entry: Entry) -> bool:
    """Return whether an entry is of a learner: neither of a shipped player nor of the oracle."""
    return entry.player not in {score_statistics.ORACLE, *COMMON_PLAYERS, *TASK_PLAYERS.get(entry.task, {})}


def require_bits(entries) -> None:
    """Skip a test where another MuJoCo, NumPy or system than that of the entries promises no equal bits."""
    current = list_versions()
    other = {(key, e.versions[key]) for e in entries.values() for key in VERSIONS_OF_BITS[:-1]} - set(current.items())
    if other:
        pytest.skip(f"made with {', '.join(' '.join(pair) for pair in sorted(other))}")


def take_first_episodes(entry: Entry, episodes: int) -> Entry:
    """Return an entry with only the first episodes."""
    steps = int(entry.steps[:episodes].sum())
    return dataclasses.replace(
        entry, seeds=entry.seeds[:episodes], steps=entry.steps[:episodes], actions=entry.actions[:steps],
        rewards=entry.rewards[:steps], observation_digests=entry.observation_digests[: steps + episodes],
        scores={name: values[:episodes] for name, values in entry.scores.items()},
    )  # fmt: skip


def test_published_entries_are_named_by_their_content_and_are_of_todays_physics(entries):
    for (archive, name), e in entries.items():
        assert name.startswith(f"{e.task}-{e.split}-"), name
        assert name.startswith(archive), f"{name} in {archive}.zip"
        assert name.endswith(f"-{e.run}.bench"), name
        assert e.versions.get(PHYSICS) == list_versions()[PHYSICS], f"{name}: its numbers no longer hold"


def test_each_published_run_of_a_learner_states_the_command_that_trains_it_again(entries):
    assert [name for (_, name), e in entries.items() if is_learned(e) and not e.training] == []


def test_the_tables_of_the_page_follow_from_the_published_entries(entries):
    checks = [EntryCheck(replayed=True, shipped=not is_learned(e), retrained=True) for e in entries.values()]
    rows = score_statistics.compute_rows(entries.values(), checks)
    for table in score_statistics.format_rows(rows).split("\n\n"):
        assert f"\n{table}\n" in PAGE, table


def test_the_tables_of_the_page_have_the_rows_of_the_published_csv_and_no_others():
    with (DOCS / "data" / "headline" / "headline.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        value, low, high = (float(row[name]) for name in ("value", "low", "high"))
        runs = f"{row['runs']} x {row['episodes']}" + (
            f", {row['copies']} copies left out" if int(row["copies"]) else ""
        )
        text = f"\n| {row['player']} | {runs} | {value:.3f} ({low:.3f} to {high:.3f}) |"
        assert text in PAGE, text
    assert PAGE.count(" (track host)\n") == len({(row["task"], row["split"]) for row in rows})


def test_the_first_episodes_of_published_entries_are_replayed(entries):
    """The test replays the entry with the fewest steps of each task and player."""
    require_bits(entries)
    ordered = sorted(entries.items(), key=lambda item: (item[1].task, item[1].player, len(item[1].rewards)))
    for _, group in itertools.groupby(ordered, key=lambda item: (item[1].task, item[1].player)):
        name, entry = next(group)
        assert registerbench.verify(take_first_episodes(entry, FEW_EPISODES)).exact, name


@pytest.mark.slow
def test_every_published_entry_is_replayed_completely(entries):
    require_bits(entries)
    verdicts = {name: registerbench.verify(entry) for name, entry in entries.items()}
    assert {name: v for name, v in verdicts.items() if not (v.exact and v.is_complete)} == {}
