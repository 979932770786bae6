"""Studies and scripts/sweep.py: interrupted studies continue, and errors say what to do."""

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
from support.waiting import wait_until

pytest.importorskip("optuna", reason="Optuna is not installed: pip install -e '.[tune]'")

import optuna

from stage.errors import ArgumentError, StageError
from stage.study import PresetMoves, count_finished, derive_seed, open_study, read_study, run, suggest_registers
from stage.study.optuna_storage import JournalAppendLock

ROOT = Path(__file__).resolve().parents[2]
SWEEP = ROOT / "scripts" / "sweep.py"
SLOW = '''
import os, time
from stage.study import suggest_registers

def slow(trial):
    """Leaves a line "number pid" before and after its work."""
    registers = suggest_registers(trial, {"R2": "400:2800", "R4": "60:800:log"})
    for word in ("begun", "ended"):
        with open("log", "ab", buffering=0) as log:
            log.write(b"%s %d %d\\n" % (word.encode(), trial.number, os.getpid()))
        time.sleep(0.01)
    return registers["R2"] / registers["R4"]
'''


def compute_valley(trial):
    registers = suggest_registers(trial, {"R2": "400:2800", "R4": "60:800:log", "R7": "12,24"})
    return abs(registers["R2"] - 1000) / registers["R7"] + registers["R4"] + derive_seed(trial) % 10


def compute_two_goals(trial):
    registers = suggest_registers(trial, {"R2": "400:2800", "R4": "60:800:log"})
    return registers["R2"] * registers["R4"], registers["R2"] / registers["R4"]


compute_two_goals.goals = ("product", "quotient")


def list_trials(study):
    return [(t.number, t.params, t.values) for t in study.trials]


def parse_log_lines(path):
    return [(w, int(n), int(pid)) for w, n, pid in (line.split() for line in path.read_text().splitlines())]


def is_alive(pid):
    try:
        os.kill(pid, 0)
        return (
            subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()[:1]
            != "Z"
        )
    except ProcessLookupError:
        return False


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
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen([*command, "--workers", str(workers)], cwd=tmp_path, **pipes)

    driver = start(2)
    wait_until(lambda: log.exists() and len({pid for _, _, pid in parse_log_lines(log)}) == 2)
    time.sleep(rng.random() * 0.1)
    first, second = {pid for _, _, pid in parse_log_lines(log)}
    os.kill(first, signal.SIGKILL)
    wait_until(lambda: not is_alive(first))
    after = len(parse_log_lines(log))
    wait_until(lambda: len(parse_log_lines(log)) > after + 6)  # the other one continues
    driver.kill()
    driver.communicate()
    wait_until(lambda: not is_alive(second))  # and ends with its parent
    recorded = {t.number: (t.params, t.value) for t in read_study(journal).trials if t.state.name == "COMPLETE"}
    finished_numbers = {number for word, number, _ in parse_log_lines(log) if word == "ended"}
    assert len(finished_numbers - set(recorded)) <= 1  # the killed worker had finished one without recording it
    assert 3 <= len(recorded) < 60
    again = start(2)
    out, err = again.communicate(timeout=60)
    assert again.returncode == 0, err
    trials = read_study(journal).trials
    states = [t.state.name for t in trials]
    assert states.count("COMPLETE") in (60, 61)
    assert states.count("RUNNING") == len(trials) - states.count("COMPLETE") <= 1
    assert all((trials[number].params, trials[number].value) == values for number, values in recorded.items())
    started = [number for word, number, _ in parse_log_lines(log) if word == "begun"]
    assert len(started) == len(set(started))
    assert {t.number for t in trials if t.state.name == "COMPLETE"} <= set(started)
    assert re.match(r"6[01] trials finished \(", out)


@pytest.mark.parametrize("started", [b"", b'{"op_'])
def test_a_journal_without_a_complete_line_is_a_new_study(tmp_path, started):
    (tmp_path / "study").write_bytes(started)
    assert len(list_trials(run(compute_valley, tmp_path / "study", 2))) == 2


def test_the_next_writer_removes_an_incomplete_last_line(tmp_path):
    journal = tmp_path / "study"
    before = list_trials(run(compute_valley, journal, 3))
    content = journal.read_bytes()
    journal.write_bytes(content + content.splitlines()[-1][:-9])
    assert list_trials(read_study(journal)) == before
    assert list_trials(run(compute_valley, journal, 5))[:3] == before
    assert all(json.loads(line) for line in journal.read_bytes().splitlines())


def test_the_lock_of_a_killed_process_does_not_delay_others(tmp_path):
    run(compute_valley, tmp_path / "study", 1)
    if (holder := os.fork()) == 0:
        JournalAppendLock(tmp_path / "study").acquire()
        os.kill(os.getpid(), signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(holder, 0)[1]) == -signal.SIGKILL
    began = time.monotonic()
    run(compute_valley, tmp_path / "study", 2)
    assert time.monotonic() - began < 10  # Optuna's locks: 30 s


@pytest.mark.parametrize("sampler", ["TPESampler", "RandomSampler", "NSGAIISampler"])
def test_a_continued_study_equals_an_uninterrupted_one(sampler, tmp_path):
    settings = {"sampler": getattr(optuna.samplers, sampler), "seed": 3}
    straight = run(compute_two_goals, tmp_path / "straight", 14, **settings)
    run(compute_two_goals, tmp_path / "stopped", 6, **settings)
    assert list_trials(run(compute_two_goals, tmp_path / "stopped", 14, **settings)) == list_trials(straight)
    assert (
        list_trials(run(compute_two_goals, tmp_path / "other", 2, sampler=settings["sampler"], seed=4))
        != list_trials(straight)[:2]
    )


def test_a_complete_study_starts_no_worker(tmp_path, monkeypatch):
    """run(objective, storage, 2, workers=2), the second time."""
    run(compute_valley, tmp_path / "study", 3)
    monkeypatch.setattr("multiprocessing.get_context", lambda kind: pytest.fail("a worker was asked for"))
    assert len(run(compute_valley, tmp_path / "study", 2, workers=2).trials) == 3


def test_two_workers_with_one_seed_draw_different_trials(tmp_path):
    studies = [open_study(compute_valley, tmp_path / "study", seed=1) for _ in range(2)]
    drawn = [suggest_registers(study.ask(), {"R2": "1:1000000", "R4": "1:1000000"}) for study in studies]
    assert drawn[0]["R2"] != drawn[1]["R2"]
    assert drawn[0]["R2"] != drawn[0]["R4"]


def test_a_stage_error_fails_its_trial_and_another_error_ends_the_run(tmp_path):
    def fail_twice(trial):
        value = compute_valley(trial)
        if trial.number == 1:
            raise ArgumentError("R4 is not to my taste")
        if trial.number == 4:
            raise KeyError("a mistake")
        return value

    with pytest.raises(KeyError, match="a mistake"):
        run(fail_twice, tmp_path / "study", 9)
    study = read_study(tmp_path / "study")
    assert [t.state.name for t in study.trials] == ["COMPLETE", "FAIL", "COMPLETE", "COMPLETE", "FAIL"]
    assert study.trials[1].user_attrs["error"] == "ArgumentError: R4 is not to my taste"
    assert count_finished(study) == 4  # a mistake is not a result
    assert count_finished(run(fail_twice, tmp_path / "study", 9)) == 9


def test_the_error_of_another_objective_lists_the_differences(tmp_path):
    values = PresetMoves(model="xy", pulses=4000)
    open_study(values, tmp_path / "study")
    open_study(PresetMoves(model="xy", pulses=4000), tmp_path / "study")
    with pytest.raises(ArgumentError, match="another study") as refused:
        open_study(PresetMoves(values.space | {"R7": 24}, model="xy"), tmp_path / "study")
    assert "  pulses: 4000 before, 16000 now\n" in str(refused.value)
    assert re.search(r"  space: .*'R7': 12} before, .*'R7': 24} now\n", str(refused.value))
    with pytest.raises(ArgumentError, match="objective: PresetMoves before, compute_two_goals now\n  goals"):
        run(compute_two_goals, tmp_path / "study", 3)
    assert read_study(tmp_path / "study").trials == []


def test_a_study_is_refused_with_other_versions_of_the_packages(tmp_path, monkeypatch):
    open_study(compute_valley, tmp_path / "study")
    monkeypatch.setattr("stage.study.study_runner.metadata.version", lambda name: "0.0.1")
    with pytest.raises(ArgumentError, match=r"mujoco: [\d.]+ before, 0\.0\.1 now") as caught:
        open_study(compute_valley, tmp_path / "study")
    assert re.findall(r"(\w+): \S+ before, 0\.0\.1 now", str(caught.value)) == ["pulsestage", "mujoco", "numpy"]


def test_a_file_that_is_no_study_stays_unchanged(tmp_path):
    (tmp_path / "notes").write_text("no end of line")
    for place, message in (("notes", "holds no study"), ("", "is no regular file"), ("not/there", "No such file")):
        with pytest.raises(StageError, match=message):
            open_study(compute_valley, tmp_path / place)
    with pytest.raises(StageError, match="cannot hold a study"):
        open_study(compute_valley, "nonsense://")
    for place in ("notes", "nothing"):
        with pytest.raises(StageError, match="holds no study"):
            read_study(tmp_path / place)
    assert [p.name for p in tmp_path.iterdir()] == ["notes"]
    assert (tmp_path / "notes").read_text() == "no end of line"


def test_a_database_can_store_a_study(tmp_path):
    url = f"sqlite:///{tmp_path}/study.db"
    assert list_trials(run(compute_valley, url, 2)) == list_trials(run(compute_valley, tmp_path / "study", 2))
    assert count_finished(read_study(url)) == 2


@pytest.mark.parametrize(
    "invalid",
    [{"trials": 0}, {"trials": 1.5}, {"workers": 0}, {"seed": -1}, {"seed": 0.5}, {"seed": True}, {"trials": True}],
)
def test_invalid_numbers_of_a_study_are_refused(invalid, tmp_path):
    name, value = next(iter(invalid.items()))
    with pytest.raises(ArgumentError, match=f"{name}={value}: a whole number"):
        run(compute_valley, tmp_path / "study", **({"trials": 1} | invalid))


def exit_worker(trial):
    os._exit(3)


def test_workers_that_exit_early_and_objectives_that_cannot_be_pickled_raise_errors(tmp_path):
    with pytest.raises(
        StageError, match=r"0 of 3 trials are finished: workers ended with exit codes 3, 3\. Run it again"
    ):
        run(exit_worker, tmp_path / "study", 3, workers=2)
    with pytest.raises(ArgumentError, match="must be able to import the objective"):
        run(lambda trial: 0.0, tmp_path / "other", 3, workers=2)


@pytest.fixture
def run_sweep(monkeypatch, capsys, tmp_path):
    """Function that runs a command in this process, and returns its exit code, stdout and stderr."""
    spec = importlib.util.spec_from_file_location("sweep", SWEEP)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def run(command):
        monkeypatch.setattr(sys, "argv", command.split())
        return script.main(), *capsys.readouterr()

    return run


def test_the_command_continues_a_study_and_prints_its_best_trial(run_sweep, tmp_path):
    options = "--space R1=20 R4=400 R5=400 --option model=xy pulses=[500,-500] rest=0.02"
    assert run_sweep(f"sweep.py --out study.log --trials 2 {options}")[0] == 0
    code, out, _ = run_sweep(f"sweep.py --out study.log --trials 4 --top 2 --pruner median {options}")
    assert code == 0
    assert out.startswith("4 trials finished (4 complete); the best:\n")
    study = read_study(tmp_path / "study.log")
    printed = [line.split() for line in out.splitlines()[1:]]
    assert len(printed) == 2
    assert int(printed[0][0]) == study.best_trial.number
    assert float(printed[0][1]) == pytest.approx(study.best_value, rel=1e-5)
    assert f"R2={study.best_params['R2']}" in printed[0]
    assert run_sweep("sweep.py --out study.log --top 2")[1] == out
    code, out, _ = run_sweep(f"sweep.py --out pareto.log --trials 3 --sampler nsga2 --goals score vibration {options}")
    assert code == 0
    assert "the Pareto front" in out


def test_the_command_prints_why_trials_failed(run_sweep, tmp_path):
    (tmp_path / "fussy.py").write_text(
        "from stage.errors import ArgumentError\n"
        "class Fussy:\n"
        "    def __init__(self, best: float): self.best = best\n"
        "    def __call__(self, trial):\n"
        "        if trial.number == 1: raise ArgumentError('not to my taste')\n"
        "        return self.best\n"
    )
    code, out, _ = run_sweep("sweep.py --out study.log --trials 3 --objective fussy:Fussy --option best=2.5")
    assert code == 0
    assert out.splitlines() == [
        "3 trials finished (2 complete, 1 fail); the best:",
        "     0          2.5",
        "     2          2.5",
        "failed, 1: ArgumentError: not to my taste (trial 1)",
    ]


@pytest.mark.parametrize(
    ("options", "message"),
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
def test_the_error_of_an_invalid_command_says_what_to_do_and_no_study_is_made(options, message, run_sweep, tmp_path):
    code, _, err = run_sweep(f"sweep.py --out study.log {options}")
    assert code == 2
    assert err.startswith("sweep: ")
    assert message in err
    assert not (tmp_path / "study.log").exists()


@pytest.mark.slow
def test_the_documented_program_for_ray_runs(tmp_path):
    """python on_ray.py"""
    pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[cluster]'")
    program = re.search(r"```python\n(# on_ray\.py\n.*?)```", (ROOT / "docs" / "sweep.md").read_text(), re.S)[1]
    (tmp_path / "on_ray.py").write_text(program)
    completed = subprocess.run([sys.executable, "on_ray.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert completed.returncode == 0, completed.stderr
    assert count_finished(read_study(tmp_path / "moves.log")) == 40


def test_no_trial_is_pruned_without_a_pruner(tmp_path):
    assert isinstance(open_study(compute_valley, tmp_path / "study").pruner, optuna.pruners.NopPruner)
    median = optuna.pruners.MedianPruner()
    assert open_study(compute_valley, tmp_path / "other", pruner=median).pruner is median


def test_pruned_trials_count_as_finished(tmp_path):
    """run(objective, "study", trials=3) with one whose trials are all pruned"""
    started = []

    def prune(trial):
        started.append(trial.number)
        assert len(started) < 4
        raise optuna.TrialPruned

    study = run(prune, tmp_path / "study", 3)
    assert (started, count_finished(study)) == ([0, 1, 2], 3)


def test_trials_have_the_seeds_of_older_studies():
    drawn = [derive_seed(optuna.trial.FixedTrial({}, number), seed) for number, seed in ((0, 0), (5, 0), (0, 5))]
    assert drawn == [7449029282396566744, 1972919436384569406, 3508924886369872888]
