"""`Fleet`: many stages under one program each, on threads.

    fleet = Fleet([Stage("xyz") for _ in range(64)])
    program = Program().command(0, 0x08).register(0, PCL240K, "R0", 2000) ...
    played = fleet.play([program] * 64)

The result is the same as if a Python driver had done the same bus cycles on each stage alone: the same bits, on any number of
threads. Stages that are being recorded, or whose chips keep a journal, are played by Python itself. Only there are a program's
writes checked for mistakes (`chip.diagnostics`).
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import numpy as np

from stage.errors import ArgumentError, StageError, unknown_name_error
from stage.sim import engine, engine_records, program_player, stage_handle
from stage.sim.program import END, KEEP, LOOK, MEASURE, NAMES, READ, STOP, WAIT, WRITE, Program
from stage.sim.stage import Stage
from stage.sim.stage_loop import IN_USE
from stage.support.argument_checks import explain_arguments

DEVICES = ("cpu", "cuda")
MAX_TIME_NS = engine_records.SECOND * 10**9  # ns
CHUNKS_PER_THREAD = 4  # a thread's share, so that a slow stage does not hold up the rest


class PlayedPrograms(NamedTuple):
    """Results of a fleet's programs.

    Attributes:
        results: (stages, operations) int64.
        extremes: (stages, nq, 2), least and greatest qpos while measured (inf, -inf where nothing was).
        diverged: (stages,) bool, the program ended there.
    """

    results: np.ndarray
    extremes: np.ndarray
    diverged: np.ndarray


class _BackgroundPlay:
    """Programs that another thread plays while the main thread waits.

    It consists of bare locks and flags: Ctrl-C during a call of a Future may leave that locked.
    """

    def __init__(self) -> None:
        self.running = self.left = False
        self.failed: BaseException | None = None
        self.over = threading.Lock()
        self.over.acquire()


class Fleet:
    """Stages of one model and one set of axes, played together."""

    def __new__(
        cls,
        stages: Sequence[Stage],
        threads: int | None = None,
        *,
        device: str = "cpu",
        copies: int | None = None,
    ) -> Fleet:
        """Make room for a fleet on processors, or, with device="cuda", on a GPU; see `__init__`."""
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
            threads: Default: one a processor, at most one a stage.
            device: "cpu", or "cuda" for an NVIDIA GPU; see docs/gpu.md.
            copies: On a GPU, how many copies of the stage there are.

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
        self.handles = np.zeros(len(self.stages), stage_handle.HANDLE)
        self._truth = np.zeros((len(self.stages), self._axes), program_player.TRUTH)
        self._pool: ThreadPoolExecutor | None = None
        self._background: _BackgroundPlay | None = None
        for k, stage in enumerate(self.stages):
            stage_handle.fill_handle(self.handles, k, stage.state)
        self.handles["state"] = 0  # nobody takes a step back
        self._first = self.handles.ctypes.data

    def __len__(self) -> int:
        return len(self.stages)

    @explain_arguments
    def play(self, programs: Sequence[Program] | np.ndarray) -> PlayedPrograms:
        """Play programs[k] on stage k; an empty one leaves it alone.

        After Ctrl-C each stage stands somewhere in its program, in a wait for example, and can be used as before.

        Args:
            programs: One a stage; or an array (stages, operations, 4).

        Returns:
            Results, extremes, and which stages diverged.

        Raises:
            ArgumentError: A program names an axis that does not exist, or a time that is none; nothing is played then.
        """
        n, ops = len(self), check_programs(programs, len(self), self.stages[0], *self._points)
        results, status = np.zeros(ops.shape[:2], np.int64), np.zeros(n, np.int64)
        extremes = np.empty((n, self._nq, 2))
        extremes[:, :, 0], extremes[:, :, 1] = np.inf, -np.inf
        by_python = self.list_python_stages()
        compiled = ops
        if by_python:
            compiled = ops.copy()
            compiled[by_python, 0] = END
        lasts = ops[:, :, 1:].sum(dtype=float) > program_player.LONG  # times are in it
        run = self._play_interruptibly if lasts else self.run_on_threads
        run(lambda a, b: program_player.play_programs(self.handles, a, b, compiled, results, extremes, status))
        self.check_status(status)
        for k in by_python:
            status[k] = program_player.play_in_python(self.stages[k], ops[k], results[k], extremes[k])
        return PlayedPrograms(results, extremes, status == program_player.DIVERGED)

    def list_python_stages(self) -> list[int]:
        """List the stages that Python has to play: those with a recording, or whose chips have a journal or lose writes.

        Where MuJoCo has callbacks, all of them are.
        """
        indices = []
        all_of_them = engine.has_unguarded_callback.with_gil(self._first)
        for k, stage in enumerate(self.stages):
            stage.ensure_powered()
            stage.loop.check_options()
            if all_of_them or stage.recording is not None:
                indices.append(k)
                continue
            for chip in stage.chips:
                if chip.open_journal is not None or chip.glitches:
                    indices.append(k)
                    break
        return indices

    @staticmethod
    @explain_arguments
    def check_status(status: np.ndarray) -> None:
        """Check that all stages could be played.

        Args:
            status: Of `play.play`.

        Raises:
            StageError: A stage was in use.
        """
        if any(how := status.tolist()):  # of few stages faster than numpy: steps of environments pass here
            for k, why in enumerate(how):
                if why not in (program_player.PLAYED, program_player.DIVERGED):
                    raise StageError(f"stage {k} of the fleet: {IN_USE}")

    def truth(self) -> np.ndarray:
        """Return every axis of every stage now: a new array (stages, axes) of play.TRUTH."""
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
        """End the threads."""
        self._stop_background()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    @explain_arguments
    def run_on_threads(self, work: Callable[[int, int], None]) -> None:
        """Call `work` for ranges of stages that make up all of them, on the fleet's threads.

        Args:
            work: Takes begin and end of a range.
        """
        self._stop_background()
        self._run_chunks_on_threads(work)

    def _run_chunks_on_threads(self, work: Callable[[int, int], None]) -> None:
        n = len(self.stages)
        if self.threads == 1:
            work(0, n)
            return
        chunks = min(n, self.threads * CHUNKS_PER_THREAD)
        cuts = [n * k // chunks for k in range(chunks + 1)]
        left = iter(range(chunks))  # every thread takes the next, this one among them

        def share() -> None:
            for k in left:
                work(cuts[k], cuts[k + 1])

        pool = self._workers()
        jobs = [pool.submit(share) for _ in range(self.threads - 1)]
        try:
            share()
        finally:
            wait(jobs)
        for job in jobs:
            job.result()

    def _play_interruptibly(self, work: Callable[[int, int], None]) -> None:
        """Call `work` as `run_on_threads` does; Ctrl-C, which Python handles in its main thread between bytecodes only, ends it."""
        if threading.current_thread() is not threading.main_thread():
            self.run_on_threads(work)
            return
        self._stop_background()
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
            self._workers().submit(play_all)
            turn.over.acquire()
        finally:
            self._stop_background()
        if turn.failed is not None:
            raise turn.failed

    def _stop_background(self) -> None:
        """End what another thread plays for the main thread. After another Ctrl-C here, the next call does it again."""
        if threading.current_thread() is not threading.main_thread():
            return
        if self._background is not None and self._process == os.getpid():
            self._background.left = True
            self.handles["halt"] = 1
            while self._background.running:
                time.sleep(1e-3)
            self.handles["halt"] = 0
        self._background = None

    def _workers(self) -> ThreadPoolExecutor:
        """Return the threads of this process; one of them may be waiting for the others."""
        if self._process != os.getpid():  # forked: the threads are the parent's
            self._pool, self._process = None, os.getpid()
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="stage")
        return self._pool


AXIS_OPERATIONS = (WRITE, READ, LOOK)
TIME_OPERANDS = {WAIT: (1,), MEASURE: (1,), STOP: (2, 3), KEEP: (2, 3)}  # which of an operation's numbers are ns


def check_programs(
    programs: Sequence[Program] | np.ndarray, n: int, first: Stage, sites: int | None = None, bodies: int | None = None
) -> np.ndarray:
    """Check programs of `n` stages like `first`, and return them as compiled code takes them, (n, operations, 4) int64.

    Args:
        programs: One a stage; or an array (n, operations, 4).
        n: Number of stages.
        first: One of the stages.
        sites: How many sites all stages have; default: those of `first`.
        bodies: How many bodies all stages have; default: those of `first`.

    Raises:
        ArgumentError: A program names an axis or a point that does not exist, or a time that is none.
    """
    ops = programs if isinstance(programs, np.ndarray) else _stack_programs(programs)
    if ops.ndim != 3 or len(ops) != n or ops.shape[2] != 4:
        raise ArgumentError(f"programs of shape {ops.shape}: one a stage, ({n}, operations, 4).")
    ops = np.ascontiguousarray(ops, np.int64)
    model = first.model
    _check_operations(
        ops, list(first.axes), model.nsite if sites is None else sites, model.nbody if bodies is None else bodies
    )
    return ops


def _check_operations(ops: np.ndarray, axes: list[str], sites: int, bodies: int) -> None:
    """Check programs, (stages, operations, 4): compiled code trusts them.

    Raises:
        ArgumentError: A program names an axis or a point that does not exist, or a time that is none.
    """
    kind, a = ops[:, :, 0], ops[:, :, 1]
    last = np.logical_or.accumulate(kind == END, axis=1)  # from here on nothing is played
    bad = (kind < 0) | (kind >= len(NAMES))
    bad |= np.isin(kind, AXIS_OPERATIONS) & ((a < 0) | (a >= len(axes)))
    bad |= np.isin(kind, (STOP, KEEP)) & ((a < 0) | (a >= 1 << len(axes)) | (ops[:, :, 2] < 1))
    for timed, numbers in TIME_OPERANDS.items():
        for n in numbers:
            bad |= (kind == timed) & ((ops[:, :, n] < 0) | (ops[:, :, n] > MAX_TIME_NS))
    bad |= np.isin(kind, (MEASURE, LOOK)) & ((ops[:, :, 2] > sites) | (ops[:, :, 2] <= -bodies))
    bad |= (kind == LOOK) & ((ops[:, :, 3] < 0) | (ops[:, :, 3] > 2))
    bad &= ~last
    if bad.any():
        k, j = (int(n) for n in np.argwhere(bad)[0])
        op = ops[k, j].tolist()
        name = NAMES[op[0]] if 0 <= op[0] < len(NAMES) else "unknown operation"
        point = f" A point is 1 + the index of a site, up to {sites}, or - that of a body, from {1 - bodies} on."
        point = point if op[0] == MEASURE or (op[0] == LOOK and any(op[2:])) else ""
        raise ArgumentError(
            f"program {k}, operation {j}: {name} {tuple(op[1:])}. Axes are given by their index, 0 to {len(axes) - 1} "
            f"({', '.join(axes)}), several as a mask of bits; times are 0 to 1e9 s, in ns, and a poll takes 1 ns or more.{point}"
        )


def _count_processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _stack_programs(programs: Sequence[Program]) -> np.ndarray:
    """Stack programs of any lengths into one array, padded with END."""
    out = np.zeros((len(programs), max((len(p) for p in programs), default=0) or 1, 4), np.int64)
    for row, p in zip(out, programs, strict=True):
        if p.ops:
            row[: len(p)] = p.ops
    return out
