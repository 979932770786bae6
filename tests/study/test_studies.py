"""Studies and scripts/sweep.py: a kill takes the trial under way and no other, and the same command goes on after it."""

import importlib.util
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.examples import SEED

pytest.importorskip("optuna", reason="Optuna is not installed: pip install 'pulsestage[tune]'")

import optuna

from stage.errors import ArgumentError, StageError
from stage.study import PresetMoves, finished, open_study, read_study, run, seed_of, suggest
from stage.study.storage import Lock

ROOT = Path(__file__).resolve().parents[2]
SWEEP = ROOT / "scripts" / "sweep.py"
SLOW = '''
import os, time
from stage.study import suggest

def slow(trial):
    """Leaves a line "number pid" before and after its work."""
    registers = suggest(trial, {"R2": "400:2800", "R4": "60:800:log"})
    for word in ("begun", "ended"):
        with open("log", "ab", buffering=0) as log:
            log.write(b"%s %d %d\\n" % (word.encode(), trial.number, os.getpid()))
        time.sleep(0.01)
    return registers["R2"] / registers["R4"]
'''


def valley(trial):
    registers = suggest(trial, {"R2": "400:2800", "R4": "60:800:log", "R7": "12,24"})
    return abs(registers["R2"] - 1000) / registers["R7"] + registers["R4"] + seed_of(trial) % 10


def two(trial):
    registers = suggest(trial, {"R2": "400:2800", "R4": "60:800:log"})
    return registers["R2"] * registers["R4"], registers["R2"] / registers["R4"]


two.goals = ("product", "quotient")


def made(study):
    return [(t.number, t.params, t.values) for t in study.trials]


def lines(path):
    return [(w, int(n), int(pid)) for w, n, pid in (line.split() for line in path.read_text().splitlines())]


def alive(pid):
    try:
        os.kill(pid, 0)
        return (
            subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()[:1]
            != "Z"
        )
    except ProcessLookupError:
        return False


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds} s"
        time.sleep(0.01)


@pytest.mark.slow
def test_a_killed_study_loses_only_its_running_trials_and_continues(tmp_path):
    """python scripts/sweep.py --out study.log --trials 60 --workers 2 --objective mine:slow, its processes killed one by one"""
    print(f"seed {SEED}")
    rng = random.Random(SEED)
    (tmp_path / "mine.py").write_text(SLOW)
    log, journal = tmp_path / "log", tmp_path / "study.log"
    command = [
        sys.executable,
        SWEEP,
        "--out",
        journal,
        "--trials",
        "60",
        "--objective",
        "mine:slow",
        "--sampler",
        "random",
    ]

    def start(workers):
        more = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen([*command, "--workers", str(workers)], cwd=tmp_path, **more)

    driver = start(2)
    wait_for(lambda: log.exists() and len({pid for _, _, pid in lines(log)}) == 2)
    time.sleep(rng.random() * 0.1)
    first, second = {pid for _, _, pid in lines(log)}
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: not alive(first))
    after = len(lines(log))
    wait_for(lambda: len(lines(log)) > after + 6)  # the other one goes on
    driver.kill()
    driver.communicate()
    wait_for(lambda: not alive(second))  # and ends with its parent
    kept = {t.number: (t.params, t.value) for t in read_study(journal).trials if t.state.name == "COMPLETE"}
    ended = {number for word, number, _ in lines(log) if word == "ended"}
    assert len(ended - set(kept)) <= 1  # that of the killed worker, between its end and its record
    assert 3 <= len(kept) < 60
    again = start(2)
    out, err = again.communicate(timeout=60)
    assert again.returncode == 0, err
    trials = read_study(journal).trials
    states = [t.state.name for t in trials]
    assert states.count("COMPLETE") in (60, 61)
    assert states.count("RUNNING") == len(trials) - states.count("COMPLETE") <= 1
    assert all((trials[number].params, trials[number].value) == was for number, was in kept.items())
    started = [number for word, number, _ in lines(log) if word == "begun"]
    assert len(started) == len(set(started))
    assert {t.number for t in trials if t.state.name == "COMPLETE"} <= set(started)
    assert re.match(r"6[01] trials finished \(", out)


@pytest.mark.parametrize("started", [b"", b'{"op_'])
def test_a_journal_whose_first_writer_was_killed_before_its_first_line_is_a_new_one(tmp_path, started):
    (tmp_path / "study").write_bytes(started)
    assert len(made(run(valley, tmp_path / "study", 2))) == 2


def test_a_line_that_was_cut_short_is_cut_off_by_the_next_writer(tmp_path):
    journal = tmp_path / "study"
    before = made(run(valley, journal, 3))
    whole = journal.read_bytes()
    journal.write_bytes(whole + whole.splitlines()[-1][:-9])
    assert made(read_study(journal)) == before
    assert made(run(valley, journal, 5))[:3] == before
    assert all(json.loads(line) for line in journal.read_bytes().splitlines())


def test_the_lock_of_a_killed_process_keeps_nobody_waiting(tmp_path):
    run(valley, tmp_path / "study", 1)
    if (holder := os.fork()) == 0:
        Lock(tmp_path / "study").acquire()
        os.kill(os.getpid(), signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(holder, 0)[1]) == -signal.SIGKILL
    began = time.monotonic()
    run(valley, tmp_path / "study", 2)
    assert time.monotonic() - began < 10  # Optuna's locks: 30 s


@pytest.mark.parametrize("sampler", ["TPESampler", "RandomSampler", "NSGAIISampler"])
def test_one_worker_makes_the_same_study_stopped_in_between_or_not(sampler, tmp_path):
    how = {"sampler": getattr(optuna.samplers, sampler), "seed": 3}
    straight = run(two, tmp_path / "straight", 14, **how)
    run(two, tmp_path / "stopped", 6, **how)
    assert made(run(two, tmp_path / "stopped", 14, **how)) == made(straight)
    assert made(run(two, tmp_path / "other", 2, sampler=how["sampler"], seed=4)) != made(straight)[:2]


def test_a_study_that_has_its_trials_starts_no_worker(tmp_path, monkeypatch):
    """run(objective, storage, 2, workers=2), the second time."""
    run(valley, tmp_path / "study", 3)
    monkeypatch.setattr("multiprocessing.get_context", lambda kind: pytest.fail("a worker was asked for"))
    assert len(run(valley, tmp_path / "study", 2, workers=2).trials) == 3


def test_two_workers_with_one_seed_draw_different_trials(tmp_path):
    studies = [open_study(valley, tmp_path / "study", seed=1) for _ in range(2)]
    drawn = [suggest(study.ask(), {"R2": "1:1000000", "R4": "1:1000000"}) for study in studies]
    assert drawn[0]["R2"] != drawn[1]["R2"]
    assert drawn[0]["R2"] != drawn[0]["R4"]


def test_a_trial_that_raises_a_stage_error_has_failed_and_any_other_error_ends_the_run(tmp_path):
    def picky(trial):
        value = valley(trial)
        if trial.number == 1:
            raise ArgumentError("R4 is not to my taste")
        if trial.number == 4:
            raise KeyError("a mistake")
        return value

    with pytest.raises(KeyError, match="a mistake"):
        run(picky, tmp_path / "study", 9)
    study = read_study(tmp_path / "study")
    assert [t.state.name for t in study.trials] == ["COMPLETE", "FAIL", "COMPLETE", "COMPLETE", "FAIL"]
    assert study.trials[1].user_attrs["error"] == "ArgumentError: R4 is not to my taste"
    assert finished(study) == 4  # a mistake is not a result
    assert finished(run(picky, tmp_path / "study", 9)) == 9


def test_another_objective_is_refused_with_what_differs(tmp_path):
    was = PresetMoves(model="xy", pulses=4000)
    open_study(was, tmp_path / "study")
    open_study(PresetMoves(model="xy", pulses=4000), tmp_path / "study")
    with pytest.raises(ArgumentError, match="another study") as refused:
        open_study(PresetMoves(was.space | {"R7": 24}, model="xy"), tmp_path / "study")
    assert "  pulses: 4000 before, 16000 now\n" in str(refused.value)
    assert re.search(r"  space: .*'R7': 12} before, .*'R7': 24} now\n", str(refused.value))
    with pytest.raises(ArgumentError, match="objective: PresetMoves before, two now\n  goals"):
        run(two, tmp_path / "study", 3)
    assert read_study(tmp_path / "study").trials == []


def test_other_versions_of_the_packages_make_another_study(tmp_path, monkeypatch):
    open_study(valley, tmp_path / "study")
    monkeypatch.setattr("stage.study.runner.metadata.version", lambda name: "0.0.1")
    with pytest.raises(ArgumentError, match=r"mujoco: [\d.]+ before, 0\.0\.1 now") as caught:
        open_study(valley, tmp_path / "study")
    assert re.findall(r"(\w+): \S+ before, 0\.0\.1 now", str(caught.value)) == ["pulsestage", "mujoco", "numpy"]


def test_a_file_that_is_no_study_stays_unchanged(tmp_path):
    (tmp_path / "notes").write_text("no end of line")
    for place, message in (("notes", "holds no study"), ("", "is no regular file"), ("not/there", "No such file")):
        with pytest.raises(StageError, match=message):
            open_study(valley, tmp_path / place)
    with pytest.raises(StageError, match="cannot hold a study"):
        open_study(valley, "nonsense://")
    for place in ("notes", "nothing"):
        with pytest.raises(StageError, match="holds no study"):
            read_study(tmp_path / place)
    assert [p.name for p in tmp_path.iterdir()] == ["notes"]
    assert (tmp_path / "notes").read_text() == "no end of line"


def test_a_database_holds_a_study_too(tmp_path):
    url = f"sqlite:///{tmp_path}/study.db"
    assert made(run(valley, url, 2)) == made(run(valley, tmp_path / "study", 2))
    assert finished(read_study(url)) == 2


@pytest.mark.parametrize(
    "wrong",
    [{"trials": 0}, {"trials": 1.5}, {"workers": 0}, {"seed": -1}, {"seed": 0.5}, {"seed": True}, {"trials": True}],
)
def test_numbers_out_of_range_are_refused(wrong, tmp_path):
    name, value = next(iter(wrong.items()))
    with pytest.raises(ArgumentError, match=f"{name}={value}: a whole number"):
        run(valley, tmp_path / "study", **({"trials": 1} | wrong))


def dies(trial):
    os._exit(3)


def test_workers_that_exit_early_and_objectives_that_cannot_be_pickled_raise_errors(tmp_path):
    with pytest.raises(
        StageError, match=r"0 of 3 trials are finished: workers ended with exit codes 3, 3\. Run it again"
    ):
        run(dies, tmp_path / "study", 3, workers=2)
    with pytest.raises(ArgumentError, match="must be able to import the objective"):
        run(lambda trial: 0.0, tmp_path / "other", 3, workers=2)


@pytest.fixture
def swept(monkeypatch, capsys, tmp_path):
    """Runs the command in this process; its exit code, and what it printed on stdout and stderr."""
    spec = importlib.util.spec_from_file_location("sweep", SWEEP)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def run(command):
        monkeypatch.setattr(sys, "argv", command.split())
        return script.main(), *capsys.readouterr()

    return run


def test_the_command_continues_a_study_and_prints_its_best_trial(swept, tmp_path):
    options = "--space R1=20 R4=400 R5=400 --option model=xy pulses=[500,-500] rest=0.02"
    assert swept(f"sweep.py --out study.log --trials 2 {options}")[0] == 0
    code, out, _ = swept(f"sweep.py --out study.log --trials 4 --top 2 --pruner median {options}")
    assert code == 0
    assert out.startswith("4 trials finished (4 complete); the best:\n")
    study = read_study(tmp_path / "study.log")
    shown = [line.split() for line in out.splitlines()[1:]]
    assert len(shown) == 2
    assert int(shown[0][0]) == study.best_trial.number
    assert float(shown[0][1]) == pytest.approx(study.best_value, rel=1e-5)
    assert f"R2={study.best_params['R2']}" in shown[0]
    assert swept("sweep.py --out study.log --top 2")[1] == out
    code, out, _ = swept(f"sweep.py --out pareto.log --trials 3 --sampler nsga2 --goals score vibration {options}")
    assert code == 0
    assert "the Pareto front" in out


def test_the_command_prints_why_trials_failed(swept, tmp_path):
    (tmp_path / "fussy.py").write_text(
        "from stage.errors import ArgumentError\n"
        "class Fussy:\n"
        "    def __init__(self, best: float): self.best = best\n"
        "    def __call__(self, trial):\n"
        "        if trial.number == 1: raise ArgumentError('not to my taste')\n"
        "        return self.best\n"
    )
    code, out, _ = swept("sweep.py --out study.log --trials 3 --objective fussy:Fussy --option best=2.5")
    assert code == 0
    assert out.splitlines() == [
        "3 trials finished (2 complete, 1 fail); the best:",
        "     0          2.5",
        "     2          2.5",
        "failed, 1: ArgumentError: not to my taste (trial 1)",
    ]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("", "holds no study"),
        ("--trials 0", "trials=0"),
        ("--trials 1 --workers 0", "workers=0"),
        ("--trials 1 --option pulse=3", "'pulse'. Did you mean 'pulses'? Known: space, goals, model, axis"),
        ("--trials 1 --space R2=9:1", "R2=9:1"),
        ("--trials 1 --objective not.there:f", "No module named"),
        ("--trials 1 --objective os:getcwd --option a=1", "os:getcwd is a function: it takes no a"),
    ],
)
def test_wrong_usage_says_what_to_do_and_makes_no_study(more, message, swept, tmp_path):
    code, _, said = swept(f"sweep.py --out study.log {more}")
    assert code == 2
    assert said.startswith("sweep: ")
    assert message in said
    assert not (tmp_path / "study.log").exists()


@pytest.mark.slow
def test_the_page_s_program_for_ray_runs(tmp_path):
    """python on_ray.py"""
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'pulsestage[cluster]'")
    program = re.search(r"```python\n(# on_ray\.py\n.*?)```", (ROOT / "docs" / "sweep.md").read_text(), re.S)[1]
    (tmp_path / "on_ray.py").write_text(program)
    ended = subprocess.run([sys.executable, "on_ray.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert finished(read_study(tmp_path / "moves.log")) == 40


def test_no_trial_is_pruned_without_a_pruner(tmp_path):
    assert isinstance(open_study(valley, tmp_path / "study").pruner, optuna.pruners.NopPruner)
    median = optuna.pruners.MedianPruner()
    assert open_study(valley, tmp_path / "other", pruner=median).pruner is median


def test_pruned_trials_are_finished_and_count(tmp_path):
    """run(objective, "study", trials=3) with one whose trials are all pruned"""
    started = []

    def pruned(trial):
        started.append(trial.number)
        assert len(started) < 4
        raise optuna.TrialPruned

    study = run(pruned, tmp_path / "study", 3)
    assert (started, finished(study)) == ([0, 1, 2], 3)


def test_a_seed_of_a_trial_stays_what_it_was_in_older_studies():
    drawn = [seed_of(optuna.trial.FixedTrial({}, number), seed) for number, seed in ((0, 0), (5, 0), (0, 5))]
    assert drawn == [7449029282396566744, 1972919436384569406, 3508924886369872888]
