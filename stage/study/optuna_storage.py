"""Optuna's storage and samplers, made safe for processes that are killed at any instant and for many workers."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from stage.errors import StageError
from stage.support.extras import import_extra
from stage.support.files import FileError

import_extra("optuna", "a study")

import optuna  # noqa: E402
from optuna.storages.journal import JournalFileBackend  # noqa: E402

JOURNAL_HEAD = b'{"op_code":'
"""First bytes of a journal."""


def open_storage(place: str | os.PathLike) -> optuna.storages.BaseStorage:
    """Open an Optuna storage. A file that does not exist is created.

    Args:
        place: Path of a file, or URL of a database as in SQLAlchemy.

    Raises:
        StageError: The place cannot hold a study.
    """
    try:
        if "://" in str(place):
            return optuna.storages.RDBStorage(str(place))
        return optuna.storages.JournalStorage(DurableJournal(Path(place).absolute()))
    except StageError:
        raise
    except Exception as error:  # of the file system, of JSON, of SQLAlchemy or of a database's driver
        raise StageError(f"{place} cannot hold a study: {error}") from error


class DurableJournal(JournalFileBackend):
    """Optuna's journal file (one JSON object per line), made safe against killed processes and a full disk."""

    def __init__(self, path: Path):
        if path.exists():
            if not path.is_file():
                raise StageError(f"{path} is no regular file: choose another place.")
            with path.open("rb") as file:
                head = file.read(len(JOURNAL_HEAD))
            if not JOURNAL_HEAD.startswith(head):
                raise StageError(f"{path} is there and holds no study: choose another place.")
        lock: Any = JournalAppendLock(path)  # Optuna's base class is not public
        super().__init__(str(path), lock)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Append entries to the file, and wait until they are on the disk.

        Raises:
            FileError: The file cannot be written; what was recorded before stays.
        """
        try:
            super().append_logs(logs)
        except OSError as error:
            raise FileError(
                f"{self._file_path} cannot be written: {error.strerror or error}. What was recorded before is safe: make room, "
                "then start again, and the study goes on from there."
            ) from error


class JournalAppendLock:
    """Lock that allows one process to append to the journal.

    Optuna's own locks are files: after a kill of their owner all other processes wait for half a minute. The operating system
    releases this lock at once. Its next owner removes an incomplete last line, which would make the journal unreadable.
    """

    def __init__(self, path: Path):
        self._path = path
        self._lock_file: IO | None = None

    def acquire(self) -> bool:
        """Wait for the lock, and remove an incomplete last line of the journal."""
        lock_file = Path(f"{self._path}.lock").open("a")  # noqa: SIM115
        try:
            fcntl.flock(lock_file, fcntl.LOCK_EX)
            self._remove_unfinished_line()
        except BaseException:
            lock_file.close()
            raise
        self._lock_file = lock_file
        return True

    def _remove_unfinished_line(self) -> None:
        """Cut the journal after its last complete line."""
        with self._path.open("rb+") as journal:
            end = journal.seek(0, os.SEEK_END)
            if end and (journal.seek(-1, os.SEEK_END), journal.read(1))[1] != b"\n":
                journal.seek(0)
                journal.truncate(journal.read().rfind(b"\n") + 1)

    def release(self) -> None:
        """Release the lock."""
        lock_file, self._lock_file = self._lock_file, None
        if lock_file is not None:
            lock_file.close()


class TrialSeededSampler(optuna.samplers.BaseSampler):
    """Sampler whose random numbers depend only on a seed and the number of the trial.

    A continued study therefore does not repeat its first trials, no two workers draw the same trial, and a study with one worker
    has the same bits whether it was interrupted or not.

    Args:
        make: Function that creates a sampler from a seed. The sampler must keep its state in the study, as Optuna's samplers do.
    """

    def __init__(self, make: Callable[..., optuna.samplers.BaseSampler], seed: int):
        self._make, self._seed = make, seed

    def _make_trial_sampler(self, trial: Any) -> Any:
        """Create the sampler for one trial."""
        key = (trial.number, 0, len(trial.params))
        return self._make(seed=int(np.random.SeedSequence(self._seed, spawn_key=key).generate_state(1)[0]))

    def before_trial(self, study: Any, trial: Any) -> None:
        """Call `before_trial` of the sampler with the seed of this trial."""
        self._make_trial_sampler(trial).before_trial(study, trial)

    def infer_relative_search_space(self, study: Any, trial: Any) -> dict:
        """Return the search space from the sampler with the seed of this trial."""
        return self._make_trial_sampler(trial).infer_relative_search_space(study, trial)

    def sample_relative(self, study: Any, trial: Any, search_space: dict) -> dict:
        """Sample the search space with the sampler that has the seed of this trial."""
        return self._make_trial_sampler(trial).sample_relative(study, trial, search_space)

    def sample_independent(self, study: Any, trial: Any, param_name: str, param_distribution: Any) -> Any:
        """Sample one parameter with the sampler that has the seed of this trial."""
        return self._make_trial_sampler(trial).sample_independent(study, trial, param_name, param_distribution)

    def after_trial(self, study: Any, trial: Any, state: Any, values: Any) -> None:
        """Call `after_trial` of the sampler with the seed of this trial."""
        self._make_trial_sampler(trial).after_trial(study, trial, state, values)
