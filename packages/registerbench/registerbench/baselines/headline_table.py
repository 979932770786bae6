"""The headline table of the benchmark, made from nothing by one command: tasks whose reference is far below the oracle.

python -m registerbench.baselines.headline_table -o headline --plan         states jobs and budget, and runs nothing
python -m registerbench.baselines.headline_table -o headline                two hours at most on two idle processors
python -m registerbench.baselines.headline_table -o headline --minutes 30   only the jobs that fit; later runs of learners go first
python -m registerbench.baselines.headline_table -o quick --quick           one small run, to try the command: seconds

Jobs are the players that do not learn, the oracle of each split, and the runs of the learners. A learner learns on the split
train alone, and each of its entries states the command that trains its run again. Then each table is checked: every entry is
replayed, and some runs of each learner are trained again (`--spot-check`). The folder has

entries/        one file for each run and split      runs/      learned policies and their curves
costs.csv       processor seconds of each job        headline.md, headline.csv     the tables

A finished job is not run again, so the same command continues after an interruption. What was left out, the tables say. Learners
need the extra `rl`; a learner whose library is missing is left out as well.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import registerbench
from registerbench import entry_checks, score_statistics
from registerbench.baselines import exit_on_interrupt, oracle
from registerbench.baselines.bench_entries import write_entry
from registerbench.benchmark_tasks import OPEN_ROUND
from registerbench.package_versions import list_versions
from registerbench.score_statistics import ORACLE, ORACLE_TRACK

PROCESSORS = 2  # of the machine for which the budget of two hours holds
OVERHEAD = 1.1  # factor on the processor seconds of the jobs, for imports and for the end, at which one process waits
REPLAY_SECONDS = {"one-shot": 2.0, "few-shot": 6.0, "home": 10.0}
"""Processor seconds in which the test episodes of a split are played or replayed, by task."""


@dataclass(frozen=True)
class Learner:
    """Learner of the headline table.

    Attributes:
        task: Name of the card.
        method: Name of the method, a part of the file names.
        library: Module without which the learner is left out.
        seconds: Processor seconds of a run, without its test episodes.
        length: What determines how long a run is, by the name of the option of the learner's command.
        runs: Number of runs.
    """

    task: str
    method: str
    library: str
    seconds: float
    length: Mapping[str, int] = field(default_factory=dict)
    runs: int = score_statistics.MIN_LEARNER_RUNS

    def train_and_submit(self, run: int, splits: Sequence[str], folder: Path) -> None:
        """Train a run, unless its policy exists, and write its entries.

        Args:
            run: Number of the run, its seed.
            splits: Names of the splits that it plays.
            folder: Folder of the table.
        """
        policies, entries = folder / "runs", folder / "entries"
        if self.library == "cmaes":
            from registerbench.baselines import parametric_policy_learners as learners

            learners.learn(self.task, run, policies, players=[self.method.replace("-", " ")], **self.length)
            policy = policies / f"{self.task}_{self.method}-{run}.json"
            learners.submit(policy, list(splits), entries)
            return
        from registerbench.baselines import few_shot_learners

        policy = policies / f"{self.method}-{run}.zip"
        if not policy.exists():
            few_shot_learners.learn(self.method, run, self.length["steps"], policies)
        few_shot_learners.submit(policy, list(splits), [], entries)


@dataclass(frozen=True)
class Plan:
    """Contents of a headline table.

    Attributes:
        splits: Splits by task.
        players: Players that do not learn, by task; the reference is one of them.
        oracle_tries: Tries of the oracle for each test episode, by task.
        oracle_seconds: Processor seconds of the oracle of a split, by task.
        learners: Learners.
    """

    splits: Mapping[str, tuple[str, ...]]
    players: Mapping[str, tuple[str, ...]]
    oracle_tries: Mapping[str, int]
    oracle_seconds: Mapping[str, float]
    learners: tuple[Learner, ...]


FULL_PLAN = Plan(
    splits={"few-shot": ("weak", "mast", "faults"), "home": ("train", "faults")},
    players={"few-shot": ("fixed", "search", "formula", "random"), "home": ("scripted", "random")},
    oracle_tries={"few-shot": 96, "home": 48},
    oracle_seconds={"few-shot": 250.0, "home": 300.0},
    learners=(
        Learner("few-shot", "es-with-memory", "cmaes", 35.0, {"machines": 48}),
        Learner("few-shot", "sac", "stable_baselines3", 73.0, {"steps": 4096}),
        Learner("few-shot", "ppo", "stable_baselines3", 82.0, {"steps": 6144}),
        Learner("few-shot", "recurrent-ppo", "sb3_contrib", 82.0, {"steps": 6144}),
        Learner("home", "es", "cmaes", 115.0, {"generations": 8}),
    ),
)
"""Tables of the benchmark's page. The seconds are those of the published run, on one processor of an AMD EPYC beside other work."""

QUICK_PLAN = Plan(
    splits={"one-shot": ("weak",)},
    players={"one-shot": ("fixed", "formula", "random")},
    oracle_tries={"one-shot": oracle.PARALLEL_ENVS},
    oracle_seconds={"one-shot": 30.0},
    learners=(Learner("one-shot", "es", "cmaes", 5.0, {"generations": 1}, runs=1),),
)
"""A table that is made in less than a minute, to try the command; it supports no claim."""


@dataclass(frozen=True)
class Job:
    """Part of the work that one process does.

    Attributes:
        task: Name of the card.
        splits: Names of the splits that are played.
        player: Name of the player in file names.
        run: Number of the run.
        seconds: Processor seconds that it takes.
        tries: Tries of the oracle; 0 for other players.
        learner: Learner that is trained, or None.
    """

    task: str
    splits: tuple[str, ...]
    player: str
    run: int
    seconds: float
    tries: int = 0
    learner: Learner | None = None

    @property
    def name(self) -> str:
        """Name of the job in messages and in costs.csv."""
        return f"{self.player} {self.run} on {self.task} {', '.join(self.splits)}"

    def list_missing_splits(self, folder: Path) -> list[str]:
        """Return the splits whose entries do not exist in the folder of a table."""
        names = {split: f"{self.task}-{split}-{self.player}-{self.run}.bench" for split in self.splits}
        return [split for split, name in names.items() if not (folder / "entries" / name).exists()]

    def run_in(self, folder: Path) -> float:
        """Do the work in the folder of a table, and return the processor seconds that it took."""
        start_s, entries = measure_processor_seconds(), folder / "entries"
        missing = self.list_missing_splits(folder)
        if self.learner is not None:
            self.learner.train_and_submit(self.run, missing, folder)
            return measure_processor_seconds() - start_s
        for split in missing:
            if self.tries:
                policy: Any = oracle.search_split(self.task, split, OPEN_ROUND, self.tries)
                write_entry(policy, self.task, split, entries, ORACLE, self.run, name=ORACLE, track=ORACLE_TRACK)
            else:
                write_entry(self.player, self.task, split, entries, self.player, self.run, name=self.player)
        return measure_processor_seconds() - start_s


def measure_processor_seconds() -> float:
    """Return the processor seconds of this process and of its finished children."""
    return sum(os.times()[:4])


def list_jobs(plan: Plan) -> list[Job]:
    """List the jobs of a plan in their order: players that do not learn, oracles, then run after run of all learners."""
    jobs = [
        Job(task, plan.splits[task], player, 0, REPLAY_SECONDS[task] * len(plan.splits[task]))
        for task, players in plan.players.items()
        for player in players
    ]
    jobs += [
        Job(task, (split,), ORACLE, 0, plan.oracle_seconds[task], tries=plan.oracle_tries[task])
        for task, splits in plan.splits.items()
        for split in splits
    ]
    for run in range(max((learner.runs for learner in plan.learners), default=0)):
        for learner in (x for x in plan.learners if run < x.runs):
            splits = plan.splits[learner.task]
            seconds = learner.seconds + REPLAY_SECONDS[learner.task] * len(splits)
            jobs.append(Job(learner.task, splits, learner.method, run, seconds, learner=learner))
    return jobs


def estimate_check_seconds(jobs: Iterable[Job], spot_checks: int) -> float:
    """Estimate the processor seconds in which the entries of some jobs are replayed, and some of their runs trained again."""
    jobs = list(jobs)
    replays = sum(REPLAY_SECONDS[job.task] * len(job.splits) for job in jobs)
    trained = [job for job in jobs if job.learner is not None and job.run < spot_checks]
    return replays + sum(
        len(job.splits) * (job.learner.seconds + REPLAY_SECONDS[job.task]) for job in trained if job.learner is not None
    )


def select_jobs(
    jobs: Sequence[Job], done: Sequence[Job], minutes: float, processes: int, spot_checks: int
) -> tuple[list[Job], list[Job]]:
    """Select the jobs that fit into a time with the check of all entries, in their order.

    Args:
        jobs: Jobs that are not done yet.
        done: Jobs that are done, whose entries are checked as well.
        minutes: Time in minutes.
        processes: Number of processes.
        spot_checks: Number of runs of each learner that are trained again.

    Returns:
        Selected jobs, and those that are left out.
    """
    selected: list[Job] = []
    for k, job in enumerate(jobs):
        check_seconds = estimate_check_seconds((*done, *selected, job), spot_checks)
        seconds = sum(x.seconds for x in (*selected, job)) + check_seconds
        if seconds * OVERHEAD / processes > minutes * 60:
            return selected, list(jobs[k:])
        selected.append(job)
    return selected, []


def run_jobs(jobs: Sequence[Job], folder: Path, processes: int) -> None:
    """Run jobs, and add a row to costs.csv for each that has finished."""
    for number, (job, seconds) in enumerate(_run_all([(job, job.run_in, (folder,)) for job in jobs], processes), 1):
        _append_cost(folder, job.name, seconds)
        print(f"{number} of {len(jobs)}: {job.name}, {seconds:.0f} s of a processor", flush=True)


def _run_all(calls: Sequence[tuple[Any, Any, tuple]], processes: int) -> Iterator[tuple[Any, Any]]:
    """Yield (key, result) of calls (key, function, arguments) as they finish, in processes of their own if there are several."""
    if processes == 1:
        yield from ((key, function(*arguments)) for key, function, arguments in calls)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        futures: dict[Future, Any] = {pool.submit(function, *arguments): key for key, function, arguments in calls}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _append_cost(folder: Path, name: str, seconds: float) -> None:
    """Add a row to costs.csv."""
    path = folder / "costs.csv"
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        csv.writer(file).writerows([*([("job", "processor_s")] if is_new else []), (name, f"{seconds:.1f}")])


def check_table(folder: Path, task: str, split: str, spot_checks: int) -> tuple[dict[str, Any], float]:
    """Check the entries of a task and split.

    Args:
        folder: Folder of the table.
        task: Name of the card.
        split: Name of the split.
        spot_checks: Number of runs of each learner that are trained again.

    Returns:
        Check of each entry by its file name, and the processor seconds that the checks took.
    """
    start_s = measure_processor_seconds()
    entries = {path.name: registerbench.read_entry(path) for path in _list_entries(folder, task, split)}
    checks = entry_checks.check_entries(entries.values(), spot_checks=spot_checks)
    return dict(zip(entries, checks, strict=True)), measure_processor_seconds() - start_s


def _list_entries(folder: Path, task: str, split: str) -> list[Path]:
    """List the files of the entries of a task and split."""
    return sorted((folder / "entries").glob(f"{task}-{split}-*.bench"))


def write_tables(folder: Path, plan: Plan, left_out: Sequence[str], processes: int, spot_checks: int) -> None:
    """Check all entries of a plan, and write headline.md and headline.csv.

    Args:
        folder: Folder of the table.
        plan: Plan of the table.
        left_out: Names of the jobs that were not run.
        processes: Number of processes.
        spot_checks: Number of runs of each learner that are trained again.
    """
    tables = [(task, split) for task, splits in plan.splits.items() for split in splits]
    rows: dict[tuple[str, str], list[score_statistics.ScoreRow]] = {}
    calls = [(key, check_table, (folder, *key, spot_checks)) for key in tables]
    for key, (checks, seconds) in _run_all(calls, processes):
        _append_cost(folder, f"check of {' '.join(key)}", seconds)
        entries = [registerbench.read_entry(folder / "entries" / name) for name in checks]
        rows[key] = score_statistics.compute_rows(entries, list(checks.values()))
        print(f"checked {' '.join(key)}: {len(entries)} entries", flush=True)
    ordered = [row for key in tables for row in rows[key]]
    with (folder / "headline.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(ordered[0].json()) if ordered else ["task"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(row.json() for row in ordered)
    text = [score_statistics.format_rows(rows[key]) for key in tables]
    versions = ", ".join(f"{name} {version}" for name, version in sorted(list_versions().items()))
    notes = [f"Versions: {versions}."]
    if left_out:
        notes.append(f"Not run: {'; '.join(left_out)}.")
    (folder / "headline.md").write_text("\n\n".join([*text, *notes]) + "\n")


def find_missing_libraries(plan: Plan) -> list[str]:
    """Return the modules that learners of a plan need and that are not installed."""
    return [name for name in sorted({x.library for x in plan.learners}) if importlib.util.find_spec(name) is None]


def format_budget(jobs: Sequence[Job], done: Sequence[Job], left_out: int, processes: int, spot_checks: int) -> str:
    """Format the sentence that states the budget before the first job.

    Args:
        jobs: Jobs that are going to run.
        done: Jobs that were finished before, whose entries are checked as well.
        left_out: Number of jobs that are left out.
        processes: Number of processes.
        spot_checks: Number of runs of each learner that are trained again.
    """
    seconds = (sum(job.seconds for job in jobs) + estimate_check_seconds((*done, *jobs), spot_checks)) * OVERHEAD
    return (
        f"{len(jobs)} jobs ({len(done)} more are done, {left_out} left out) and the check of their entries: "
        f"{seconds / 60:.1f} minutes of a processor, {seconds / 60 / processes:.1f} minutes with {processes} processes "
        "if they have the machine to themselves"
    )


def make_tables(args: argparse.Namespace) -> None:
    """Run the jobs of the plan that are not done, and write the tables."""
    plan, folder = QUICK_PLAN if args.quick else FULL_PLAN, args.out
    missing = find_missing_libraries(plan)
    plan = replace(plan, learners=tuple(x for x in plan.learners if x.library not in missing))
    jobs = list_jobs(plan)
    todo = [job for job in jobs if job.list_missing_splits(folder)]
    done = [job for job in jobs if job not in todo]
    selected, left_out = todo, list[Job]()
    if args.minutes is not None:
        selected, left_out = select_jobs(todo, done, args.minutes, args.processes, args.spot_check)
    print(format_budget(selected, done, len(left_out), args.processes, args.spot_check), flush=True)
    if args.plan:
        for job in selected:
            print(f"{job.seconds:6.0f} s  {job.name}")
        return
    (folder / "entries").mkdir(parents=True, exist_ok=True)
    run_jobs(selected, folder, args.processes)
    names = [job.name for job in left_out] + [f"learners that need {name}" for name in missing]
    write_tables(folder, plan, names, args.processes, args.spot_check)
    print(f"{folder / 'headline.md'}: written")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--plan", action="store_true", help="state jobs and budget, and run nothing")
    parser.add_argument("--quick", action="store_true", help="one small run, to try the command")
    parser.add_argument("--minutes", type=float, metavar="N", help="leave out the jobs that do not fit (default: none)")
    parser.add_argument("--processes", type=int, default=PROCESSORS, metavar="N", help=f"(default: {PROCESSORS})")
    parser.add_argument(
        "--spot-check",
        type=int,
        default=1,
        metavar="N",
        help="runs of each learner that are trained again (default: 1)",
    )
    with exit_on_interrupt("the finished jobs are saved, and the same command continues after them."):
        make_tables(parser.parse_args(arguments))


if __name__ == "__main__":
    main()
