"""Workers of a study with fake processes, samplers seeded by the number of a trial, and the lock of the journal."""

import errno
import fcntl
import os
from types import SimpleNamespace

import pytest

pytest.importorskip("optuna", reason="Optuna is not installed: pip install -e '.[tune]'")

import optuna

from stage.errors import ArgumentError, StageError
from stage.study import count_finished, open_study, optuna_storage, read_study, run, study_runner
from stage.study.optuna_storage import DurableJournal, JournalAppendLock, TrialSeededSampler
from stage.study.study_runner import _optimize, _run_worker
from stage.support.files import FileError


def compute_valley(trial):
    return abs(trial.suggest_int("R2", 400, 2800) - 1000)


class FakeProcess:
    """Process that runs `run_worker` when it is joined, and records its calls."""

    def __init__(self, events, run_worker, target, args, daemon):
        self.events, self.run_worker, self.target, self.args, self.pid, self.exitcode = (
            events,
            run_worker,
            target,
            args,
            None,
            None,
        )
        events.append(("made", target, args[2], daemon))

    def start(self):
        self.pid = 77
        self.events.append("started")

    def join(self):
        self.events.append("joined")
        if self.exitcode is None:
            self.exitcode = self.run_worker(*self.args)

    def terminate(self):
        self.events.append("terminated")


@pytest.fixture
def spawn_fake_workers(monkeypatch):
    """Function that makes the runner spawn fake processes with this function, and returns their events."""

    def spawn(run_worker):
        events = []
        context = SimpleNamespace(Process=lambda **settings: FakeProcess(events, run_worker, **settings))
        monkeypatch.setattr(study_runner.multiprocessing, "get_context", lambda kind: (events.append(kind), context)[1])
        return events

    return spawn


def test_each_worker_is_spawned_with_the_full_task_and_joined(spawn_fake_workers, tmp_path):
    arguments = []

    def run_worker(objective, place, trials, settings):
        arguments.append((objective, place, trials, settings))
        _optimize(open_study(objective, place, **settings), objective, trials)
        return 0

    events = spawn_fake_workers(run_worker)
    sampler, pruner = optuna.samplers.RandomSampler, optuna.pruners.MedianPruner()
    study = run(compute_valley, tmp_path / "study", 4, workers=3, sampler=sampler, pruner=pruner, seed=9)
    assert events == [
        "spawn", *[("made", _run_worker, 4, True)] * 3, *["started"] * 3, *["joined"] * 3, *["terminated", "joined"] * 3,
    ]  # fmt: skip
    assert arguments == [(compute_valley, tmp_path / "study", 4, {"sampler": sampler, "pruner": pruner, "seed": 9})] * 3
    assert count_finished(study) == 4


def test_the_error_of_unfinished_trials_states_how_the_workers_exited(spawn_fake_workers, tmp_path):
    codes = iter((0, -9))
    spawn_fake_workers(lambda objective, place, trials, settings: next(codes))
    with pytest.raises(
        StageError, match=r"^0 of 2 trials are finished: workers ended with exit codes 0, -9\. Run it again"
    ):
        run(compute_valley, tmp_path / "study", 2, workers=2)


def test_ctrl_c_terminates_only_started_workers(spawn_fake_workers, tmp_path, monkeypatch):
    events = spawn_fake_workers(lambda *_: 0)
    monkeypatch.setattr(FakeProcess, "start", lambda self: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        run(compute_valley, tmp_path / "study", 2, workers=2)
    assert events[3:] == []


def test_an_objective_that_workers_cannot_import_is_refused_before_they_start(spawn_fake_workers, tmp_path):
    events = spawn_fake_workers(lambda *_: 0)
    with pytest.raises(ArgumentError, match="workers=2: processes must be able to import the objective: "):
        run(lambda trial: 0.0, tmp_path / "study", 2, workers=2)
    assert events == []


def test_a_worker_that_starts_after_the_last_trial_runs_none(tmp_path):
    study = run(compute_valley, tmp_path / "study", 3)
    _optimize(study, compute_valley, 3)
    assert len(study.trials) == 3
    _optimize(study, compute_valley, 4)
    assert len(study.trials) == 4


def test_a_worker_whose_parent_has_died_ends_after_its_trial(tmp_path, monkeypatch):
    study, lives = open_study(compute_valley, tmp_path / "study"), [True, False]
    parent = SimpleNamespace(is_alive=lambda: lives.pop(0))
    monkeypatch.setattr(study_runner.multiprocessing, "parent_process", lambda: parent)
    _optimize(study, compute_valley, 9)
    assert len(study.trials) == 2


@pytest.mark.parametrize(
    ("error", "code", "message"), [(StageError("no room"), 2, "no room"), (KeyboardInterrupt(), 130, "")]
)
def test_a_worker_prints_its_error_and_exits_with_a_code(error, code, message, monkeypatch, capsys, tmp_path):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(study_runner, "open_study", refuse)
    with pytest.raises(SystemExit) as ended:
        _run_worker(compute_valley, tmp_path / "study", 1, {})
    assert ended.value.code == code
    assert capsys.readouterr().err == (f"worker {os.getpid()}: {message}\n" if message else "")


def test_only_complete_pruned_and_failed_trials_count_as_finished():
    def trial(state, **attributes):
        return SimpleNamespace(state=SimpleNamespace(name=state), user_attrs=attributes)

    some = [
        trial("COMPLETE"), trial("PRUNED"), trial("FAIL"), trial("FAIL", error="no"), trial("RUNNING"), trial("WAITING", seed=1),
    ]  # fmt: skip
    assert count_finished(SimpleNamespace(get_trials=lambda deepcopy: some)) == 3


def test_a_study_uses_the_requested_sampler_and_pruner_or_tpe_and_none(tmp_path):
    usual = open_study(compute_valley, tmp_path / "usual")
    assert (usual.study_name, [d.name for d in usual.directions]) == ("study", ["MINIMIZE"])
    assert (usual.sampler._make, usual.sampler._seed) == (optuna.samplers.TPESampler, 0)
    assert isinstance(usual.pruner, optuna.pruners.NopPruner)
    pruner = optuna.pruners.MedianPruner()
    requested = open_study(
        compute_valley, tmp_path / "own", sampler=optuna.samplers.RandomSampler, pruner=pruner, seed=4
    )
    assert (requested.sampler._make, requested.sampler._seed, requested.pruner) == (
        optuna.samplers.RandomSampler,
        4,
        pruner,
    )


def test_reading_an_empty_storage_is_refused(tmp_path):
    optuna_storage.open_storage(tmp_path / "empty").get_all_studies()
    with pytest.raises(ArgumentError, match="holds no study"):
        read_study(tmp_path / "empty")


class RecordingSampler:
    """Sampler that records its calls."""

    events = []  # noqa: RUF012

    def __init__(self, seed):
        self.seed = seed

    def __getattr__(self, name):
        return lambda *arguments: (self.events.append((name, self.seed, arguments)), name)[1]


def test_each_trial_has_a_sampler_seeded_by_its_number(monkeypatch):
    monkeypatch.setattr(RecordingSampler, "events", [])
    sampler, trial = TrialSeededSampler(RecordingSampler, 5), SimpleNamespace(number=3, params={})
    requested = [
        ("before_trial", ("study", trial)), ("infer_relative_search_space", ("study", trial)),
        ("sample_relative", ("study", trial, "space")), ("sample_independent", ("study", trial, "R2", "range")),
        ("after_trial", ("study", trial, "state", [1.0])),
    ]  # fmt: skip
    answers = [getattr(sampler, name)(*arguments) for name, arguments in requested]
    assert answers == [None, "infer_relative_search_space", "sample_relative", "sample_independent", None]
    assert [(name, arguments) for name, _, arguments in RecordingSampler.events] == requested
    assert len({seed for _, seed, _ in RecordingSampler.events}) == 1
    others = [
        (5, SimpleNamespace(number=4, params={})), (5, SimpleNamespace(number=3, params={"R2": 1})),
        (6, SimpleNamespace(number=3, params={})),
    ]  # fmt: skip
    for seed, other in others:
        TrialSeededSampler(RecordingSampler, seed).before_trial("study", other)
    assert len({seed for _, seed, _ in RecordingSampler.events}) == 4, (
        "another seed for each trial number, set of parameters, and study seed"
    )
    assert RecordingSampler.events[0][1] == 2014078169, "as older studies have drawn"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", b""),
        (b"one\n", b"one\n"),
        (b"one\ntwo\n", b"one\ntwo\n"),
        (b"one\ntw", b"one\n"),
        (b"on", b""),
        (b"one\n\n", b"one\n\n"),
    ],
)
def test_the_lock_removes_an_incomplete_last_line_of_the_journal(tmp_path, content, expected):
    path = tmp_path / "study"
    path.write_bytes(content)
    lock = JournalAppendLock(path)
    assert lock.acquire() is True
    assert path.read_bytes() == expected
    lock.release()
    lock.release()


def test_a_lock_is_exclusive_until_its_release_and_after_a_failed_acquire(tmp_path):
    path = tmp_path / "study"
    lock = JournalAppendLock(path)
    with pytest.raises(FileNotFoundError):
        lock.acquire()

    def is_locked():
        with open(f"{path}.lock", "a") as other:
            try:
                fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    assert not is_locked(), "the journal is not there, and nobody holds its lock"
    path.write_bytes(b"")
    lock.acquire()
    assert is_locked()
    lock.release()
    assert not is_locked()


def test_the_error_of_a_full_disk_states_which_trials_are_saved(tmp_path, monkeypatch):
    journal = DurableJournal(tmp_path / "study")

    def raise_disk_full(self, logs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(optuna_storage.JournalFileBackend, "append_logs", raise_disk_full)
    with pytest.raises(
        FileError, match=r"study cannot be written: No space left on device\. What was recorded before is safe"
    ):
        journal.append_logs([{}])
