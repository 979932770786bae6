"""`Fleet`: many stages under one program each, on threads.

    fleet = Fleet([Stage("xyz") for _ in range(64)])
    program = Program().command(0, 0x08).register(0, PCL240K, "R0", 2000) ...
    played = fleet.play([program] * 64)

The result is the same as if a Python driver had made the same bus cycles on each stage alone: the same bits, on any number of
threads. Python itself plays the programs of stages that are being recorded, or whose chips have an open journal. Only on these
stages does `chip.diagnostics` list writes that break a rule.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import numpy as np

from stage.chips import observer_attributes
from stage.errors import ArgumentError, StageError, unknown_name_error
from stage.sim import compiled_stage_access, engine, engine_records, program_player
from stage.sim.program import (
    AWAIT_STOP,
    AWAIT_STOP_OR_LOST_STEP,
    END,
    MEASURE,
    OPERATION_NAMES,
    READ,
    SAMPLE_POSITION,
    WAIT,
    WRITE,
    Program,
)
from stage.sim.stage import Stage
from stage.sim.stage_loop import IN_USE_MESSAGE
from stage.support.argument_checks import WrongType, explain_arguments

DEVICES = ("cpu", "cuda")
MAX_TIME_NS = engine_records.NS_PER_SECOND * 10**9  # ns
CHUNKS_PER_THREAD = 4  # a thread's run_next_chunks, so that a slow stage does not hold up the rest


class PlayedPrograms(NamedTuple):
    """Results of the programs that the stages of a fleet have played.

    Attributes:
        results: (stages, operations) int64.
        extremes: (stages, nq, 2), least and greatest qpos during the operations MEASURE; inf, -inf in a program without them.
        diverged: (stages,) bool, whether the simulation diverged, which ended the program.
    """

    results: np.ndarray
    extremes: np.ndarray
    diverged: np.ndarray


class _BackgroundPlay:
    """Programs that another thread plays while the main thread waits.

    It consists of plain locks and flags, because Ctrl-C during a call of a Future may leave the Future locked.
    """

    def __init__(self) -> None:
        self.running = self.left = False
        self.failed: BaseException | None = None
        self.over = threading.Lock()
        self.over.acquire()


class Fleet:
    """Stages of one model and one set of axes, played together."""

    def __new__(
        cls, stages: Sequence[Stage], threads: int | None = None, *, device: str = "cpu", copies: int | None = None
    ) -> Fleet:
        """Create a `Fleet`, or a `GpuFleet` if `device` is "cuda"; see `__init__`."""
        if device not in DEVICES:
            raise unknown_name_error("device", device, DEVICES)
        if device == "cuda" and cls is Fleet:
            from stage.sim.gpu.gpu_fleet import GpuFleet  # few have a GPU

            return super().__new__(GpuFleet)
        return super().__new__(cls)

    @explain_arguments
    def __init__(
        self, stages: Sequence[Stage], threads: int | None = None, *, device: str = "cpu", copies: int | None = None
    ):
        """Make a fleet of these stages.

        Args:
            stages: Stages of one model and one set of axes; on a GPU one stage.
            threads: Number of threads; default: one for each processor, at most one for each stage.
            device: "cpu", or "cuda" for an NVIDIA GPU; see docs/gpu.md.
            copies: Number of copies of the stage on a GPU.

        Attributes:
            handles: A HANDLE for each stage, for compiled code; not on a GPU.

        Raises:
            ArgumentError: An argument is out of range. On a GPU also ExtraMissing, GpuMissing and ModelError.
        """
        if copies is not None:
            raise ArgumentError(f'copies={copies!r}: of device="cuda" alone; on processors give the stages themselves.')
        if not len(stages):
            raise ArgumentError("a fleet has at least one stage.")
        if len({id(s) for s in stages}) < len(stages):
            raise ArgumentError("a stage is in the fleet twice: a fleet is of different stages, copy.deepcopy(stage).")
        if threads is not None and (int(threads) != threads or threads < 1):
            raise ArgumentError(f"threads={threads!r}: a whole number, 1 or more.")
        kinds = sorted({(tuple(s.axes), s.model.nq) for s in stages})
        if len(kinds) > 1:
            raise ArgumentError(f"the stages of a fleet have the same axes and coordinates; here are {kinds}.")
        self.stages = list(stages)
        self.threads = min(threads or _count_processors(), len(self.stages))
        first = self.stages[0]
        self._nq, self._axes = first.model.nq, len(first.axes)
        self._points = min(s.model.nsite for s in stages), min(s.model.nbody for s in stages)
        self._process = os.getpid()
        self.handles = np.zeros(len(self.stages), compiled_stage_access.HANDLE)
        self._truth = np.zeros((len(self.stages), self._axes), program_player.TRUTH)
        self._loops = [stage.loop for stage in self.stages]
        self._observed: list[int] = []
        self._observer_changes = -1
        self._pool: ThreadPoolExecutor | None = None
        self._background: _BackgroundPlay | None = None
        for k, stage in enumerate(self.stages):
            compiled_stage_access.fill_handle(self.handles, k, stage.state)
        self.handles["state"] = 0  # nobody takes a step back
        self._first = self.handles.ctypes.data

    def __len__(self) -> int:
        return len(self.stages)

    @explain_arguments
    def play(self, programs: Sequence[Program] | np.ndarray) -> PlayedPrograms:
        """Play programs[k] on stage k. An empty program leaves its stage as it is.

        After Ctrl-C each stage has stopped at some point of its program, for example in a wait, and remains usable.

        Args:
            programs: One program per stage, or an array of shape (stages, operations, 4).

        Returns:
            Results, extremes, and which stages diverged.

        Raises:
            ArgumentError: A program names an axis that does not exist, or has an invalid time. No program is played then.
        """
        n, ops = len(self), check_programs(programs, len(self), self.stages[0], *self._points)
        results, status = np.zeros(ops.shape[:2], np.int64), np.zeros(n, np.int64)
        extremes = np.empty((n, self._nq, 2))
        extremes[:, :, 0], extremes[:, :, 1] = np.inf, -np.inf
        by_python = self.list_stages_played_in_python()
        compiled = ops
        if by_python:
            compiled = ops.copy()
            compiled[by_python, 0] = END
        lasts = ops[:, :, 1:].sum(dtype=float) > program_player.MIN_BACKGROUND_PLAY_NS  # times are in it
        self.run_on_threads(
            lambda a, b: program_player.play_programs(self.handles, a, b, compiled, results, extremes, status), lasts
        )
        self.check_status(status)
        for k in by_python:
            status[k] = program_player.play_in_python(self.stages[k], ops[k], results[k], extremes[k])
        return PlayedPrograms(results, extremes, status == program_player.DIVERGED)

    def list_stages_played_in_python(self) -> list[int]:
        """List the stages whose programs Python must play: the observed ones; all if MuJoCo has Python callbacks."""
        for stage in self.stages:
            stage.ensure_powered()
        observed = self.list_observed_stages()
        return list(range(len(self))) if engine.has_unguarded_callback.with_gil(self._first) else observed

    def list_observed_stages(self) -> list[int]:
        """List the stages that have a recording, or whose chips have a journal or a fault of the bus.

        Raises:
            StageError: The time step or the integrator of a stage's model has changed.
        """
        for loop in self._loops:
            loop.check_integration_options()
        if self._observer_changes != observer_attributes.changes[0]:
            self._observer_changes = observer_attributes.changes[0]
            self._observed = [k for k, stage in enumerate(self.stages) if is_observed(stage)]
        return self._observed

    @staticmethod
    def check_status(status: np.ndarray) -> None:
        """Check that the programs of all stages could be played.

        Args:
            status: Status of each stage, as compiled code returns it, (stages,).

        Raises:
            ArgumentError: The status is no array.
            StageError: Another thread used a stage.
        """
        try:
            how = status.tolist()  # of few stages faster than numpy: steps of environments pass here
        except AttributeError:
            raise WrongType(f"status={status!r}: give an array of integers, one for each stage.") from None
        if any(how):
            for k, why in enumerate(how):
                if why not in (program_player.PLAYED, program_player.DIVERGED):
                    raise StageError(f"stage {k} of the fleet: {IN_USE_MESSAGE}")

    def truth(self) -> np.ndarray:
        """Return the true state of every axis of every stage now: a new array (stages, axes) of TRUTH records."""
        for stage in self.stages:
            stage.ensure_powered()
        program_player.inspect_axes(self.handles, 0, len(self), self._truth)
        return self._truth.copy()

    def __getnewargs__(self) -> tuple[list[Stage]]:
        return (self.stages,)

    def __getstate__(self) -> dict[str, Any]:
        return {"stages": self.stages, "threads": self.threads}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["stages"], state["threads"])  # type: ignore[misc]

    def close(self) -> None:
        """End the threads of the fleet."""
        self.stop_background()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    @explain_arguments
    def run_on_threads(self, work: Callable[[int, int], None], interruptible: bool = False) -> None:
        """Call `work` on the fleet's threads, for ranges of stages that together contain every stage.

        Args:
            work: Function of the begin and the end of a range of stage indices.
            interruptible: Whether Ctrl-C in the main thread ends programs of `work`, at the cost of another thread.
        """
        self.stop_background()
        if interruptible and threading.current_thread() is threading.main_thread():
            self._play_in_background(work)
        else:
            self._run_chunks_on_threads(work)

    def _run_chunks_on_threads(self, work: Callable[[int, int], None]) -> None:
        """Divide the stages into chunks, and call `work` for each on the next free thread."""
        n = len(self.stages)
        if self.threads == 1:
            work(0, n)
            return
        chunks = min(n, self.threads * CHUNKS_PER_THREAD)
        cuts = [n * k // chunks for k in range(chunks + 1)]
        left = iter(range(chunks))  # every thread takes the next, this one among them

        def run_next_chunks() -> None:
            for k in left:
                work(cuts[k], cuts[k + 1])

        pool = self._get_thread_pool()
        jobs = [pool.submit(run_next_chunks) for _ in range(self.threads - 1)]
        try:
            run_next_chunks()
        finally:
            wait(jobs)
        for job in jobs:
            job.result()

    def _play_in_background(self, work: Callable[[int, int], None]) -> None:
        """Call `work` for all stages while this thread, the main one, waits and receives Ctrl-C."""
        turn = self._background = _BackgroundPlay()

        def play_all() -> None:
            turn.running = True
            try:
                if not turn.left:
                    self._run_chunks_on_threads(work)
            except BaseException as error:
                turn.failed = error
            finally:
                turn.running = False
                turn.over.release()

        try:
            self._get_thread_pool().submit(play_all)
            turn.over.acquire()
        finally:
            self.stop_background()
        if turn.failed is not None:
            raise turn.failed

    def stop_background(self) -> None:
        """End the programs that a background thread plays. If Ctrl-C interrupts this, the next call of `play` repeats it."""
        if self._background is None or threading.current_thread() is not threading.main_thread():
            return
        if self._process == os.getpid():
            self._background.left = True
            self.handles["halt"] = 1
            while self._background.running:
                time.sleep(1e-3)
            self.handles["halt"] = 0
        self._background = None

    def _get_thread_pool(self) -> ThreadPoolExecutor:
        """Return the thread pool of this process, and make it if the process is new, for example after a fork."""
        if self._process != os.getpid():  # forked: the threads are the parent's
            self._pool, self._process = None, os.getpid()
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="stage")
        return self._pool


def is_observed(stage: Stage) -> bool:
    """Return whether Python must make the bus cycles of a stage: it is recorded, or a chip has a journal or a fault of the bus."""
    return stage.recording is not None or any(c.open_journal is not None or c.glitches for c in stage.chips)


AXIS_OPERATIONS = (WRITE, READ, SAMPLE_POSITION)
# which of an operation's numbers are ns
TIME_OPERANDS = {WAIT: (1,), MEASURE: (1,), AWAIT_STOP: (2, 3), AWAIT_STOP_OR_LOST_STEP: (2, 3)}


def check_programs(
    programs: Sequence[Program] | np.ndarray,
    stage_count: int,
    first_stage: Stage,
    site_count: int | None = None,
    body_count: int | None = None,
) -> np.ndarray:
    """Check programs, and convert them to the array that compiled code takes.

    Args:
        programs: One program per stage, or an array of shape (stages, operations, 4).
        stage_count: Number of stages.
        first_stage: One of the stages, which are all equal.
        site_count: Number of sites of all stages together; default: the number of `first_stage`.
        body_count: Number of bodies of all stages together; default: the number of `first_stage`.

    Returns:
        Operations of all programs, (stages, operations, 4) int64.

    Raises:
        ArgumentError: A program names an axis or a point that does not exist, or a time that is out of range.
    """
    ops = programs if isinstance(programs, np.ndarray) else _stack_programs(programs)
    if ops.ndim != 3 or len(ops) != stage_count or ops.shape[2] != 4:
        raise ArgumentError(f"programs of shape {ops.shape}: one a stage, ({stage_count}, operations, 4).")
    ops = np.ascontiguousarray(ops, np.int64)
    model = first_stage.model
    sites = model.nsite if site_count is None else site_count
    bodies = model.nbody if body_count is None else body_count
    _check_operations(ops, list(first_stage.axes), sites, bodies)
    return ops


def _check_operations(operations: np.ndarray, axes: list[str], site_count: int, body_count: int) -> None:
    """Check programs, (stages, operations, 4): compiled code trusts them.

    Raises:
        ArgumentError: A program names an axis or a point that does not exist, or a time that is none.
    """
    kind, a = operations[:, :, 0], operations[:, :, 1]
    last = np.logical_or.accumulate(kind == END, axis=1)  # from here on nothing is played
    bad = (kind < 0) | (kind >= len(OPERATION_NAMES))
    bad |= np.isin(kind, AXIS_OPERATIONS) & ((a < 0) | (a >= len(axes)))
    bad |= np.isin(kind, (AWAIT_STOP, AWAIT_STOP_OR_LOST_STEP)) & (
        (a < 0) | (a >= 1 << len(axes)) | (operations[:, :, 2] < 1)
    )
    for timed, numbers in TIME_OPERANDS.items():
        for n in numbers:
            bad |= (kind == timed) & ((operations[:, :, n] < 0) | (operations[:, :, n] > MAX_TIME_NS))
    bad |= np.isin(kind, (MEASURE, SAMPLE_POSITION)) & (
        (operations[:, :, 2] > site_count) | (operations[:, :, 2] <= -body_count)
    )
    bad |= (kind == SAMPLE_POSITION) & ((operations[:, :, 3] < 0) | (operations[:, :, 3] > 2))
    bad &= ~last
    if bad.any():
        k, j = (int(n) for n in np.argwhere(bad)[0])
        op = operations[k, j].tolist()
        name = OPERATION_NAMES[op[0]] if 0 <= op[0] < len(OPERATION_NAMES) else "unknown operation"
        point = (
            f" A point is 1 + the index of a site, up to {site_count}, or - that of a body, from {1 - body_count} on."
        )
        point = point if op[0] == MEASURE or (op[0] == SAMPLE_POSITION and any(op[2:])) else ""
        raise ArgumentError(
            f"program {k}, operation {j}: {name} {tuple(op[1:])}. Axes are given by their index, 0 to {len(axes) - 1} "
            f"({', '.join(axes)}), several as a mask of bits; times are 0 to 1e9 s, in ns, and a poll takes 1 ns or more.{point}"
        )


def _count_processors() -> int:
    """Return the number of logical processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _stack_programs(programs: Sequence[Program]) -> np.ndarray:
    """Stack programs of any lengths into one array, padded with END."""
    out = np.zeros((len(programs), max((len(p) for p in programs), default=0) or 1, 4), np.int64)
    for row, p in zip(out, programs, strict=True):
        if p.ops:
            row[: len(p)] = p.ops
    return out
