"""Run a study with Optuna: begin or continue it, in this process or in several."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import pickle
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stage.errors import ArgumentError, StageError
from stage.support.argument_checks import check_integer, explain_arguments

if TYPE_CHECKING:
    import optuna

Objective = Callable[["optuna.Trial"], Any]
"""Measures a trial: returns a number, the less the better, or as many as its attribute `goals` has names."""

STUDY_NAME = "study"
"""Name of the only study in a storage."""


def open_study(
    objective: Objective,
    storage: Any,
    *,
    sampler: Callable[..., optuna.samplers.BaseSampler] | None = None,
    pruner: optuna.pruners.BasePruner | None = None,
    seed: int = 0,
) -> optuna.Study:
    """Open the study in a storage, or create a study that minimizes.

    Args:
        objective: Objective of the study.
        storage: Path of a file that processes of one machine share, or URL of a database, for many machines.
        sampler: Function that creates a sampler from a seed, for example optuna.samplers.NSGAIISampler; default: TPE.
        pruner: Optuna pruner; default: no trial is pruned.
        seed: Seed of the sampler.

    Returns:
        The study.

    Raises:
        ArgumentError: The storage holds the study of another objective; the message says what differs.
        StageError: The storage cannot be opened, or Optuna is not installed.
    """
    from stage.study.optuna_storage import TrialSeededSampler, open_storage, optuna

    check_integer("seed", seed, 0)
    study = optuna.create_study(
        storage=open_storage(storage),
        sampler=TrialSeededSampler(sampler or optuna.samplers.TPESampler, seed),
        pruner=pruner or optuna.pruners.NopPruner(),
        study_name=STUDY_NAME,
        directions=["minimize"] * len(get_goals(objective)),
        load_if_exists=True,
    )
    wanted, was = describe_objective(objective), study.user_attrs.get("definition")
    if was is None:
        study.set_user_attr("definition", wanted)
    elif was != wanted:
        differences = [
            f"{name}: {was.get(name, 'not given')} before, {wanted.get(name, 'not given')} now"
            for name in {**was, **wanted}
            if was.get(name) != wanted.get(name)
        ]
        raise ArgumentError(
            f"{storage} holds another study:\n  "
            + "\n  ".join(differences)
            + "\nChoose another place, or remove that study."
        )
    return study


@explain_arguments
def read_study(storage: str | os.PathLike) -> optuna.Study:
    """Open the study in `storage` for reading, also while it runs.

    Raises:
        ArgumentError: There is no study.
    """
    from stage.study.optuna_storage import open_storage, optuna

    if "://" in str(storage) or Path(storage).exists():
        opened = open_storage(storage)
        if optuna.get_all_study_names(opened):
            return optuna.load_study(study_name=STUDY_NAME, storage=opened)
    raise ArgumentError(f"{storage} holds no study.")


@explain_arguments
def run(
    objective: Objective,
    storage: Any,
    trials: int,
    *,
    workers: int = 1,
    sampler: Callable[..., optuna.samplers.BaseSampler] | None = None,
    pruner: optuna.pruners.BasePruner | None = None,
    seed: int = 0,
) -> optuna.Study:
    """Run the study in a storage until it has a given number of finished trials, those of earlier runs included.

    A trial that raises a StageError is finished too: it has failed, and its user attribute "error" says why. Any other exception
        ends the
    run. A trial whose process was killed does not count, and another trial replaces it.

    Args:
        objective: Objective of the study.
        storage: Path of a file, or URL of a database, see `open_study`.
        trials: Total number of finished trials after the run.
        workers: Number of processes; 1 runs the trials in this process. Each worker may finish one trial more than necessary. With
            several workers the objective must be importable, and the calling program needs `if __name__ == "__main__"`.
        sampler: Function that creates a sampler from a seed, see `open_study`.
        pruner: Optuna pruner, see `open_study`.
        seed: Seed of the sampler.

    Returns:
        The study.

    Raises:
        StageError: The workers ended before the study had its trials.
    """
    if not callable(objective):
        raise ArgumentError(f"objective={objective!r}: give a function of a trial, as PresetMoves().")
    check_integer("trials", trials, 1)
    check_integer("workers", workers, 1)
    how = {"sampler": sampler, "pruner": pruner, "seed": seed}
    study = open_study(objective, storage, **how)  # type: ignore[arg-type]
    if count_finished(study) >= trials:
        return study
    if workers == 1:
        _optimize(study, objective, trials)
        return study
    try:
        pickle.dumps((objective, how))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ArgumentError(f"workers={workers}: processes must be able to import the objective: {error}.") from error
    spawn = multiprocessing.get_context("spawn")  # MuJoCo's and our threads do not survive a fork
    processes = [
        spawn.Process(target=_run_worker, args=(objective, storage, trials, how), daemon=True) for _ in range(workers)
    ]
    try:
        for process in processes:
            process.start()
        for process in processes:
            process.join()
    finally:
        for process in processes:
            if process.pid is not None:
                process.terminate()
                process.join()
    if (done := count_finished(study)) < trials:
        codes = ", ".join(str(process.exitcode) for process in processes)
        raise StageError(
            f"{done} of {trials} trials are finished: workers ended with exit codes {codes}. Run it again to go on."
        )
    return study


@explain_arguments
def count_finished(study: optuna.Study) -> int:
    """Count the trials that are complete, pruned or failed with a recorded error. Trials of killed processes do not count."""
    return sum(
        t.state.name in ("COMPLETE", "PRUNED") or "error" in t.user_attrs for t in study.get_trials(deepcopy=False)
    )


def get_goals(objective: Objective) -> tuple[str, ...]:
    """Return the names of the quantities that an objective minimizes."""
    return tuple(getattr(objective, "goals", ("score",)))


def describe_objective(objective: Objective) -> dict[str, str]:
    """Return the settings on which the results of a study depend, as far as they are known. A study must not mix different ones."""
    named = objective if hasattr(objective, "__qualname__") else type(objective)
    fields = dataclasses.fields(objective) if dataclasses.is_dataclass(objective) else ()
    settings = {f.name: repr(getattr(objective, f.name)) for f in fields}
    packages = {name: metadata.version(name) for name in ("pulsestage", "mujoco", "numpy")}
    return {"objective": named.__qualname__, "goals": repr(get_goals(objective)), **settings, **packages}


def _optimize(study: optuna.Study, objective: Objective, trials: int) -> None:
    """Run trials in this process until the study has enough of them."""
    parent = multiprocessing.parent_process()

    def run_trial(trial: optuna.Trial) -> Any:
        """Run the objective; store the message of a StageError in the trial."""
        try:
            return objective(trial)
        except StageError as error:
            trial.set_user_attr("error", f"{type(error).__name__}: {error}")
            raise

    def stop(study: optuna.Study, _: object) -> None:
        """Stop the study when it has enough trials, or when the parent process has ended."""
        if count_finished(study) >= trials or (parent is not None and not parent.is_alive()):
            study.stop()

    if count_finished(study) < trials:
        study.optimize(run_trial, catch=(StageError,), callbacks=[stop])


def _run_worker(objective: Objective, storage: Any, trials: int, study_options: dict[str, Any]) -> None:
    """Run trials in a worker process, which ends when its parent process ends for any reason."""
    try:
        _optimize(open_study(objective, storage, **study_options), objective, trials)
    except StageError as error:
        print(f"worker {os.getpid()}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
