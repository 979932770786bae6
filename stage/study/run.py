"""Run the trials of a study: on local processes or threads, or on Ray. The executor does not change a bit of the results.

    with Study.open("study", definition) as study, Processes(definition.objective, workers=4) as executor:
        tally = run(study, executor)

A trial that raises is tried at most RETRIES times more, then recorded as failed with its message. A trial whose worker dies is run
again on another one; a trial that has taken LIVES workers with it counts as failed.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for_futures
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_pipes
from typing import Any, NamedTuple, Protocol

from stage.errors import ArgumentError, StageError
from stage.study.definition import Trial, resolve, versions
from stage.study.trials import OWN, Record, Study

RETRIES = 2
LIVES = 5
BATCH, EVERY = 32, 2.0
"""Results are written when there are so many, or after so many seconds."""
STILLBORN = 3  # workers in a row that end before they are ready
OBJECT_STORE = 100_000_000  # bytes; trials and results are small
POLL = 0.1  # s


class Outcome(NamedTuple):
    """How one evaluation ended: "values"; "raised", with the message; "lost" with its worker; "broken": no trial can run."""

    kind: str
    values: dict[str, float] | None = None
    message: str = ""


class Executor(Protocol):
    """Where trials run. `submit` takes as many trials as there are slots before `wait` returns some."""

    @property
    def slots(self) -> int: ...
    def submit(self, trial: Trial) -> None: ...
    def wait(self, timeout: float) -> list[tuple[int, Outcome]]: ...
    def close(self) -> None: ...
    def __enter__(self) -> Any: ...
    def __exit__(self, *exc: object) -> None: ...


@dataclass
class Tally:
    """How far a run is. before: trials that were recorded when it began; again: trials run again, for their worker died."""

    total: int
    before: int
    done: int = 0
    failed: int = 0
    running: int = 0
    again: int = 0
    best: tuple[float, int] | None = None
    stopped: bool = False

    @property
    def left(self) -> int:
        return self.total - self.done - self.failed


def run(
    study: Study,
    executor: Executor,
    *,
    batch: int = BATCH,
    every: float = EVERY,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[Tally], object] = lambda tally: None,
) -> Tally:
    """Run what is pending in `study`, and record it in parts of `batch` trials or what `every` seconds brought.

    stop: asked ten times a second; True ends the run early, with everything that has finished recorded.
    Raises StageError when workers cannot run trials at all.
    """
    queue = deque(study.pending())
    trials: dict[int, Trial] = {}
    raised: dict[int, int] = {}
    lost: dict[int, int] = {}
    finished: list[Record] = []
    tally = Tally(study.definition.trials, study.definition.trials - len(queue), study.done, study.failed)
    tally.best, written = study.best, time.monotonic()

    def flush() -> None:
        nonlocal written
        study.append(finished)
        finished.clear()
        written = time.monotonic()
        tally.best = study.best

    def end(record: Record) -> None:
        finished.append(record)
        if record.values is None:
            tally.failed += 1
        else:
            tally.done += 1

    def take(id: int, outcome: Outcome) -> None:
        trial = trials.pop(id)
        if outcome.kind == "broken":
            raise StageError(f"no trial can run: {outcome.message}")
        if outcome.kind == "lost":
            lost[id] = lost.get(id, 0) + 1
            if lost[id] < LIVES:
                tally.again += 1
                queue.appendleft(id)
                return
            message = f"took {LIVES} workers with it; the last one: {outcome.message}"
            end(Record(trial, error=message, attempts=raised.get(id, 0)))
            return
        attempts = raised[id] = raised.get(id, 0) + 1
        if outcome.kind == "raised" and attempts <= RETRIES:
            queue.appendleft(id)
            return
        end(Record(trial, outcome.values, outcome.message or None, attempts))

    try:
        while queue or trials:
            if stop():
                tally.stopped = True
                break
            while queue and len(trials) < executor.slots:
                trial = study.definition.trial(queue.popleft())
                trials[trial.id] = trial
                executor.submit(trial)
            for id, outcome in executor.wait(POLL):
                take(id, outcome)
            if finished and (len(finished) >= batch or time.monotonic() - written >= every):
                flush()
            tally.running = len(trials)
            progress(tally)
    finally:
        flush()
        tally.running = 0
        progress(tally)
    return tally


def evaluate(objective: str, trial: Trial, path: Sequence[str] = (), expected: dict[str, str] | None = None) -> Outcome:
    """One evaluation, where the trial runs. path: more places of modules. expected: the versions that the study keeps to."""
    sys.path += [place for place in path if place not in sys.path]
    if expected is not None and (here := versions()) != expected:
        return Outcome("broken", message=f"a worker has {here}, the study keeps to {expected}.")
    try:
        function = resolve(objective)
    except ArgumentError as error:
        return Outcome("broken", message=str(error))
    try:
        return Outcome("values", _checked(function(trial), trial))
    except (Exception, SystemExit) as error:
        return Outcome("raised", message=f"{type(error).__name__}: {error}")


def _checked(values: Any, trial: Trial) -> dict[str, float]:
    """What the objective measured, as plain Python numbers."""
    if not hasattr(values, "items"):
        raise ArgumentError(f"the objective returned {values!r}: a dict of numbers is needed.")
    checked: dict[str, float] = {}
    for name, value in values.items():
        plain = value.item() if hasattr(value, "item") else value
        if not isinstance(name, str) or not name or name in OWN or name in trial.registers:
            raise ArgumentError(
                f"the objective measured {name!r}: a name, and none of {', '.join(OWN)} or a register's."
            )
        if not isinstance(plain, int | float) or not (isinstance(plain, float) or -(2**63) <= plain < 2**63):
            raise ArgumentError(f"the objective measured {name}={value!r}: a number of 64 bits is needed.")
        checked[name] = int(plain) if isinstance(plain, bool) else plain
    return checked


def processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _workers(workers: int | None) -> int:
    if workers is not None and (int(workers) != workers or workers < 1):
        raise ArgumentError(f"workers={workers!r}: a whole number, 1 or more.")
    return int(workers or processors())


class _Closing:
    def __enter__(self) -> Any:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None: ...


class Threads(_Closing):
    """Threads of this process. The compiled engine lets go of the GIL, Python does not."""

    def __init__(self, objective: str, workers: int | None = None):
        self.slots, self._objective = _workers(workers), objective
        self._pool = ThreadPoolExecutor(self.slots, thread_name_prefix="trial")
        self._futures: dict[Future, int] = {}

    def submit(self, trial: Trial) -> None:
        self._futures[self._pool.submit(evaluate, self._objective, trial)] = trial.id

    def wait(self, timeout: float) -> list[tuple[int, Outcome]]:
        done, _ = wait_for_futures(self._futures, timeout, FIRST_COMPLETED)
        return [(self._futures.pop(f), f.result()) for f in done]

    def close(self) -> None:
        """Trials that run go on to their end; their results are dropped."""
        self._pool.shutdown(cancel_futures=True)


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    trial: Trial | None = None
    ready: bool = False


class Processes(_Closing):
    """Worker processes, each with a pipe of its own: a worker that dies takes its own trial down and no other."""

    def __init__(self, objective: str, workers: int | None = None):
        self._count, self._objective = _workers(workers), objective
        self._context = multiprocessing.get_context("spawn")  # no locks of MuJoCo or numba held by a fork
        self._workers: list[_Worker] = []
        self._stillborn = 0

    @property
    def slots(self) -> int:
        return self._count

    @property
    def pids(self) -> list[int]:
        return [w.process.pid for w in self._workers]

    def submit(self, trial: Trial) -> None:
        idle = next((w for w in self._workers if w.trial is None), None)
        if idle is not None:
            try:
                idle.trial = trial
                idle.pipe.send(trial)
                return
            except OSError:  # it died in its sleep
                self._bury(idle)
        self._start(trial)

    def _start(self, trial: Trial) -> None:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs, self._objective), daemon=True)
        resource_tracker.ensure_running()  # its start would lift the mask
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # Ctrl-C reaches all; the driver decides
        process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        theirs.close()
        self._workers.append(_Worker(process, ours, trial))

    def wait(self, timeout: float) -> list[tuple[int, Outcome]]:
        outcomes = []
        busy = {w.pipe: w for w in self._workers if w.trial is not None}
        for pipe in wait_for_pipes(list(busy), timeout):
            worker = busy[pipe]  # type: ignore[index]
            trial = worker.trial
            assert trial is not None
            try:
                answer = worker.pipe.recv()
                if not worker.ready:
                    worker.ready, self._stillborn = True, 0
                    worker.pipe.send(trial)
                    continue
                outcomes.append((trial.id, answer))
                worker.trial = None
            except (EOFError, OSError):
                code = self._bury(worker)
                if worker.ready:
                    outcomes.append((trial.id, Outcome("lost", message=code)))
                    continue
                self._stillborn += 1
                if self._stillborn >= STILLBORN:
                    raise StageError(f"{STILLBORN} worker processes in a row did not start: {code}.") from None
                self._start(trial)
        return outcomes

    def _bury(self, worker: _Worker) -> str:
        self._workers.remove(worker)
        worker.pipe.close()
        worker.process.join(1)
        code = worker.process.exitcode
        if code is None:
            worker.process.kill()
            worker.process.join()
            return "closed its pipe"
        return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"

    def close(self) -> None:
        """Ends the workers and whatever they run."""
        for w in self._workers:
            w.process.terminate()
        for w in list(self._workers):
            self._bury(w)


def _serve(pipe: Connection, objective: str) -> None:
    """A worker process. It ends when the driver does, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        pipe.send("ready")
        while True:
            pipe.send(evaluate(objective, pipe.recv()))
    except (EOFError, OSError):
        return


class Ray(_Closing):
    """A Ray cluster, or (no address) a local Ray with so many workers.

    Every node needs this package in the same versions, and the module of the objective, installed or at the same path. What Ray
    would retry by itself is left to `run`, which counts. Without `workers`, as many trials are under way as there are CPUs, and as
    many wait there.
    """

    def __init__(self, objective: str, workers: int | None = None, address: str | None = None):
        self._ray = ray = _import_ray()
        self._objective, self._path, self._versions = objective, list(sys.path), versions()
        self._mine = not ray.is_initialized()
        if self._mine:
            local = {"num_cpus": _workers(workers), "include_dashboard": False, "object_store_memory": OBJECT_STORE}
            try:
                ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **({} if address else local))
            except (ConnectionError, RuntimeError, ValueError) as error:
                raise StageError(f"Ray at {address or 'this machine'} cannot be reached: {error}") from error
        self._limit = _workers(workers) if workers else None
        # no retries by Ray: a trial that kills its workers would go on for ever
        self._evaluate = ray.remote(num_cpus=1, max_retries=0)(evaluate)
        self._refs: dict[Any, int] = {}
        self._asked, self._cpus = -math.inf, 1

    @property
    def slots(self) -> int:
        if time.monotonic() - self._asked > 5:  # nodes come and go
            self._cpus, self._asked = max(int(self._ray.cluster_resources().get("CPU", 0)), 1), time.monotonic()
        return self._limit or 2 * self._cpus

    def submit(self, trial: Trial) -> None:
        self._refs[self._evaluate.remote(self._objective, trial, self._path, self._versions)] = trial.id

    def wait(self, timeout: float) -> list[tuple[int, Outcome]]:
        refs, wait = list(self._refs), self._ray.wait
        done = wait(refs, timeout=timeout)[0] and wait(refs, num_returns=len(refs), timeout=0)[0]
        return [(self._refs.pop(ref), self._outcome(ref)) for ref in done]

    def _outcome(self, ref: Any) -> Outcome:
        errors = self._ray.exceptions
        try:
            return self._ray.get(ref)
        except errors.RayTaskError as error:  # `evaluate` itself: the package is not there
            return Outcome("broken", message=str(error).strip().splitlines()[-1])
        except errors.RayError as error:
            return Outcome("lost", message=f"{type(error).__name__}: {str(error).strip().splitlines()[0]}")

    def close(self) -> None:
        for ref in self._refs:
            self._ray.cancel(ref, force=True)
        if self._mine:
            self._ray.shutdown()


def _import_ray() -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        import ray.exceptions
    except ImportError:
        raise StageError("Ray is not installed: pip install 'pulsestage[cluster]', or leave --ray out.") from None
    return ray
