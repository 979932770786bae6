"""Tests of the command that makes the headline table from nothing: its budget, its jobs, and that it continues."""

import csv
import dataclasses
import importlib.util

import pytest

from registerbench import benchmark_tasks
from registerbench.baselines import headline_table, parametric_policy_learners
from registerbench.baselines.headline_table import FULL_PLAN, QUICK_PLAN, Job
from registerbench.score_statistics import get_reference

HAS_CMAES = importlib.util.find_spec("cmaes") is not None
TWO_HOURS = 120.0


@pytest.fixture
def brief(monkeypatch):
    """Let splits have four test episodes, and runs of learners few machines."""
    card = dataclasses.replace(benchmark_tasks.CARDS["one-shot"], episodes=4)
    monkeypatch.setitem(benchmark_tasks.CARDS, "one-shot", card)
    monkeypatch.setitem(parametric_policy_learners.GENERATIONS_AND_MACHINES, "one-shot", (1, 2))
    monkeypatch.setattr(parametric_policy_learners, "EPISODES", 4)


def run_quick(folder, *more):
    headline_table.main(["-o", str(folder), "--quick", "--processes", "1", "--spot-check", "0", *more])


def test_one_command_makes_the_table_from_nothing_and_continues_after_an_interruption(brief, tmp_path, capsys):
    run_quick(tmp_path)
    jobs = 5 if HAS_CMAES else 4
    printed = capsys.readouterr().out
    assert printed.startswith(f"{jobs} jobs (0 more are done, 0 left out)"), "the budget is stated beforehand"
    text = (tmp_path / "headline.md").read_text()
    assert "**one-shot, weak, round open** (track host)" in text
    for player in ("oracle", "fixed", "formula", "random", *(["es"] if HAS_CMAES else [])):
        assert f"\n| {player} | 1 x 4 |" in text
    assert ("Not run: learners that need cmaes." in text) is not HAS_CMAES
    with (tmp_path / "headline.csv").open() as file:
        rows = {row["player"]: row for row in csv.DictReader(file)}
    assert float(rows["oracle"]["normalized"]) == 1 > float(rows["random"]["normalized"])
    assert rows["formula"]["replayed"] == "True"
    with (tmp_path / "costs.csv").open() as file:
        assert "oracle 0 on one-shot weak" in {row["job"] for row in csv.DictReader(file)}
    run_quick(tmp_path)
    assert capsys.readouterr().out.startswith(f"0 jobs ({jobs} more are done, 0 left out)")
    assert (tmp_path / "headline.md").read_text() == text
    (tmp_path / "entries" / "one-shot-weak-random-0.bench").unlink()
    run_quick(tmp_path)
    assert "1 of 1: random 0 on one-shot weak" in capsys.readouterr().out
    assert (tmp_path / "headline.md").read_text() == text, "equal seeds, equal table"


def test_the_full_plan_fits_into_two_hours_on_two_processors():
    jobs = headline_table.list_jobs(FULL_PLAN)
    assert headline_table.select_jobs(jobs, [], TWO_HOURS, 2, 1) == (jobs, [])
    assert {job.run for job in jobs if job.player == "recurrent-ppo"} == set(range(10))


def test_a_shorter_time_leaves_out_the_last_runs_of_the_learners_and_says_so(tmp_path, capsys):
    jobs = headline_table.list_jobs(FULL_PLAN)
    selected, left_out = headline_table.select_jobs(jobs, [], 60, 2, 1)
    assert selected + left_out == jobs
    assert {job.player for job in selected} >= {"formula", "scripted", "oracle"}
    assert max(job.run for job in selected) <= min(job.run for job in left_out)
    seconds = sum(job.seconds for job in selected) + headline_table.estimate_check_seconds(selected, 1)
    assert seconds * headline_table.OVERHEAD <= 2 * 3600
    run_quick(tmp_path / "none", "--plan", "--minutes", "0")
    assert capsys.readouterr().out.startswith(f"0 jobs (0 more are done, {5 if HAS_CMAES else 4} left out)")
    assert not (tmp_path / "none").exists(), "a plan runs nothing"


def test_the_budget_counts_the_check_of_entries_that_were_written_before():
    jobs = headline_table.list_jobs(FULL_PLAN)
    done, todo = jobs[:-1], jobs[-1:]
    minutes = headline_table.estimate_check_seconds(jobs, 1) * headline_table.OVERHEAD / 2 / 60
    assert headline_table.select_jobs(todo, done, minutes, 2, 1) == ([], todo)
    assert headline_table.select_jobs(todo, [], minutes, 2, 1) == (todo, [])
    budget = headline_table.format_budget([], jobs, 0, 2, 1)
    assert f"0 jobs ({len(jobs)} more are done, 0 left out)" in budget
    assert f", {minutes:.1f} minutes with 2 processes" in budget


def test_the_first_job_of_each_split_is_its_reference():
    for plan in (FULL_PLAN, QUICK_PLAN):
        jobs = headline_table.list_jobs(plan)
        for task, splits in plan.splits.items():
            assert next(job.player for job in jobs if job.task == task) == get_reference(task)
            assert all(split in benchmark_tasks.CARDS[task].splits for split in splits)


def test_a_job_is_missing_those_splits_whose_entries_do_not_exist(tmp_path):
    job = Job("home", ("train", "faults"), "scripted", 0, 1.0)
    (tmp_path / "entries").mkdir()
    (tmp_path / "entries" / "home-train-scripted-0.bench").touch()
    assert job.list_missing_splits(tmp_path) == ["faults"]


@pytest.mark.slow
def test_the_quick_command_works_in_processes_of_its_own_and_trains_again(tmp_path):
    pytest.importorskip("cmaes")
    headline_table.main(["-o", str(tmp_path), "--quick"])
    with (tmp_path / "headline.csv").open() as file:
        rows = {row["player"]: row for row in csv.DictReader(file)}
    assert rows["es"]["retrained"] == "True", rows["es"]["note"]
    assert int(rows["es"]["episodes"]) == 64
