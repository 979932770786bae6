"""Published entries: the everyday suite replays a few episodes bit for bit, the slow one all of them."""

import argparse
import dataclasses
import os
import re
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import registerbench
from registerbench import score_statistics
from registerbench.benchmark_tasks import CARDS
from registerbench.entry_files import Entry
from registerbench.package_versions import list_versions

FOLDER = Path(__file__).parents[1] / "docs" / "data" / "entries"
ENTRIES = {
    f"{archive.name}/{name}": entry
    for archive in sorted(FOLDER.glob("*.zip"))
    for name, entry in registerbench.read_entries(archive).items()
}
SAME = ("mujoco", "numpy", "system", "physics")
"""Version keys that must match for an entry to replay to the same bits."""
FEW = 2  # episodes
TASKS = ("line", "one-shot", "few-shot", "bus-target", "bus-axes")
DAILY = [
    min((n for n, e in ENTRIES.items() if e.task == task), key=lambda n: len(ENTRIES[n].rewards)) for task in TASKS
]
"""The entry with the fewest steps of each task."""


def take_first_episodes(entry: Entry, episodes: int) -> Entry:
    """Return an entry with only the first episodes."""
    steps = int(entry.steps[:episodes].sum())
    return dataclasses.replace(
        entry, seeds=entry.seeds[:episodes], steps=entry.steps[:episodes], actions=entry.actions[:steps],
        rewards=entry.rewards[:steps], observation_digests=entry.observation_digests[: steps + episodes],
        scores={name: values[:episodes] for name, values in entry.scores.items()},
    )  # fmt: skip


def bits_are_promised(entry: Entry) -> None:
    current, present = list_versions(), {"physics": "1"} | entry.versions
    if other := [f"{name} {present[name]}" for name in SAME if present[name] != current[name]]:
        pytest.skip(f"made with {', '.join(other)}")


def test_files_are_named_by_what_is_in_them_and_every_task_that_was_played_has_the_random_player():
    played = {}
    for name, e in ENTRIES.items():
        assert name.startswith(f"{e.task}.zip/{e.task}-{e.split}-"), name
        assert name.endswith(f"-{e.run}.bench"), name
        assert len(e.seeds) == CARDS[e.task].episodes, name
        played.setdefault(e.task, set()).add(e.player)
    assert played
    assert all("random" in players for players in played.values()), played


def test_the_tables_of_the_page_follow_from_the_published_entries():
    page = (FOLDER.parents[1] / "benchmark.md").read_text()
    for table in score_statistics.format_tables(ENTRIES.values(), long=True).split("\n\n"):
        assert f"\n{table}\n" in page, table


def list_documented_entries():
    """List (task, split, round, player) of the commands in the cost table; player is "learned", a name, or "" for all."""
    parser = argparse.ArgumentParser()
    for name, usual in (("tasks", []), ("splits", ["train"]), ("players", [""])):
        parser.add_argument(f"--{name}", nargs="+", default=usual)
    parser.add_argument("--round", default="open")
    page = (FOLDER.parents[1] / "benchmark.md").read_text()
    created = set()
    for script, typed in re.findall(r"`python -m registerbench\.baselines\.(\w+) ([^`]*-o entries[^`]*)`", page):
        arguments, rest = parser.parse_known_args(typed.split())
        learned = script != "bench_entries"
        of_file = rest[1].removeprefix("runs/").partition("_") if learned else ("", "", "")
        tasks = arguments.tasks or [of_file[0] if of_file[1] else "few-shot"]
        created |= set(
            product(tasks, arguments.splits, [arguments.round], ["learned"] if learned else arguments.players)
        )
    return created


def test_each_published_entry_is_generated_by_a_command_of_the_page():
    created = list_documented_entries()
    for name, e in ENTRIES.items():
        who = {"learned"} if e.cost.get("moves") else {"", e.player}
        assert {(e.task, e.split, e.round, name) for name in who} & created, name


@pytest.mark.parametrize("name", DAILY)
def test_the_first_episodes_of_a_published_entry_of_each_task_are_replayed(name):
    entry = ENTRIES[name]
    bits_are_promised(entry)
    verdict = registerbench.verify(take_first_episodes(entry, FEW))
    assert verdict.exact, verdict


@pytest.mark.slow
@pytest.mark.parametrize("name", ENTRIES)
def test_every_published_entry_is_replayed_completely(name):
    bits_are_promised(ENTRIES[name])
    verdict = registerbench.verify(FOLDER / name)
    assert verdict.exact, verdict
    assert verdict.is_complete


def test_a_published_entry_with_one_other_action_is_detected():
    entry = take_first_episodes(ENTRIES["line.zip/line-train-random-0.bench"], 1)
    bits_are_promised(entry)
    actions = entry.actions.copy()
    actions[0, 0] = np.float32(-0.9)
    assert not registerbench.verify(dataclasses.replace(entry, actions=actions)).is_confirmed


@pytest.mark.slow
def test_results_do_not_depend_on_the_cpu_features_that_numpy_uses():
    """`stage bench-verify bus-target.zip/bus-target-train-scripted-0.bench`, on processors with AVX-512 and without."""
    path = FOLDER / "bus-target.zip" / "bus-target-train-scripted-0.bench"
    bits_are_promised(registerbench.read_entry(path))
    for disabled in ("", "X86_V4 AVX512_ICL"):
        done = subprocess.run(
            [sys.executable, "-c", f"import registerbench; print(registerbench.verify({str(path)!r}).exact)"],
            env=os.environ | {"NPY_DISABLE_CPU_FEATURES": disabled},
            capture_output=True,
            text=True,
        )
        assert done.stdout.strip() == "True", done.stderr
