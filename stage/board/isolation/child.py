"""The process that isolated firmware runs in; `starter` begins it, and `stage.board.isolation.traps` is used here only."""

from __future__ import annotations

import fcntl
import os
import pickle
import select
import shutil
import threading
import time
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from stage.board import crash_report, scratch
from stage.board.board import Board
from stage.board.bus import host_record, requests
from stage.board.bus.interrupts import ANY_LINE
from stage.board.errors import HostError
from stage.board.isolation.shared_memory import LOADING, Asked, Begin, Go, Noted, Shared, SpoiltError, Stands
from stage.board.link import NOTED, Link
from stage.board.thread_runner import Loaded, Threaded
from stage.errors import StageError
from stage.sim.fingerprint import settings
from stage.sim.stage import Stage

if crash_report.IS_SUPPORTED:
    from stage.board.isolation import traps

THREAD_START_S = 0.02  # of real time, for a thread of the firmware to begin
HIGH = 200  # file descriptors: what firmware closes or writes by mistake is mostly below
CLOSED = "it closed a file descriptor that it had not opened: that was the connection of its process with the stage"
LOOK_MS = 500  # hanging up is seen at once, unless a process that the parent has forked holds the pipe as well


class Samples:
    """Where the engine samples for the parent's recording; the stage takes it for one of its own."""

    FORWARD = True

    def __init__(self, shared: Shared):
        self.samples, self.positions, self.filled = shared.samples, shared.positions, 0

    def take(self, filled: int) -> None:
        """The engine has filled so many."""
        self.filled = filled


class ChildLink(Link):
    """Notes in shared memory, and says so to the parent when there is no room for more; has the parent call Python."""

    def __init__(self, board: Board, pipe: Connection, shared_path: str):
        super().__init__(board)
        self._pipe = pipe
        self.shared = shared = Shared(shared_path, board)
        self.samples = Samples(shared)
        self.asks = 0
        self.move_to(shared.record)
        self.hooks.move_to(shared.sources)
        self.stage.state.set_edge_buffer(shared.edges)
        board.trace.kept = shared.cycles
        places = self.stage.device_state.move_to(shared.devices)
        for device in board.devices:  # after a crash they are still there
            own, places = places[: len(device.kept())], places[len(device.kept()) :]
            device.move_to(own)
        self.lay_devices()
        h = self.record
        h["edges"], h["lines"], h["edge_room"] = shared.edges.ctypes.data, shared.cycles.ctypes.data, len(shared.edges)

    def begin(self) -> None:
        super().begin()
        self.record["asks"] = self.asks

    def end(self) -> None:
        h = self.record
        self.samples.filled = int(h["filled"])
        if h["noted"] > NOTED // 2 or self.samples.filled == len(self.samples.samples):
            self.flush()

    def noted(self) -> Noted:
        """All that was noted, and the state, are in shared memory; the next notes begin anew when the parent has seen that."""
        h = self.record
        found = Noted(int(h["noted"]), int(h["filled"]))
        self.shared.keep(self.stage)
        h["faults"] = self.windows.faults if self.windows is not None else 0
        h["noted"] = h["filled"] = self.samples.filled = 0
        return found

    def flush(self) -> None:
        """The parent takes what was noted."""
        self._pipe.send(self.noted())
        self._pipe.recv()

    def call_device(self, k: int, n: int, way: int, value: int) -> int:
        return self._parent_calls(k, n, value, way)

    def loses(self, chip: int, address: int, value: int) -> bool:
        return bool(self._parent_calls(chip, address, value))

    def _hooked_in_parent(self, source: int) -> None:
        self._parent_calls(-1 - source, 0, 0)

    def hooked(self, sources: tuple[int, ...]) -> None:
        """These interrupt sources call functions in Python, of the parent's."""
        own, row = self.hooks, self.hooks.sources[ANY_LINE]
        had = own.pointer if ANY_LINE in own.functions else 0
        of_firmware = row["hook"] != had and not (ANY_LINE in sources and not had)
        own.functions = {source: partial(self._hooked_in_parent, source) for source in sources}
        own.adopt(sources, keep=of_firmware)

    def _parent_calls(self, chip: int, address: int, value: int, way: int = -1) -> int:
        self._pipe.send(Asked(self.noted(), chip, address, value, way))
        answer, well, machine, hooks = self._pipe.recv()
        if machine is not None:
            adopt(self.stage, pickle.loads(machine))
        self.stage.load_state(self.shared.state)
        self.hooked(hooks)
        if not well:
            raise StageError("Python has raised in the parent")
        return int(answer)


class ChildBoard(Board):
    """A copy of the parent's board."""

    LINTS = False  # the parent does
    link: ChildLink

    def __init__(self, pipe: Connection, begin: Begin):
        stage, options, devices = _unpickled(begin.board)
        super().__init__(stage, **options)
        self._lines = 0
        for (make, *arguments), ports in devices:
            self.put(make(*arguments), ports)
        self.link = ChildLink(self, pipe, begin.shared)
        self.link.shared.not_for_forks()
        self.link.shared.remember()

    def note(self, text: str) -> None:
        self.check_lines(self._lines)
        self._lines += 1
        if not self.link.shared.note(self.stage.now, text):
            self.link.flush()
            self.link.shared.note(self.stage.now, text)

    def go(self, go: Go) -> None:
        """Before the firmware goes on: everything is as it is in the parent."""
        link, stage, self._lines = self.link, self.stage, go.lines
        if go.machine is not None:
            adopt(stage, pickle.loads(go.machine))
        stage.load_state(link.shared.state)
        self.port_table[:] = go.ports
        stage.state.clockwork[0].sample_every = go.sample_every
        stage.loop.recording = link.samples if go.sample_every else None
        link.asks = go.asks
        link.hooked(go.hooks)


class ChildThread(Threaded):
    """Firmware in a thread of its own process: what it does beside its requests is noted, and may be the end of it."""

    isolated, outlives = True, ""

    def _check(self) -> None:
        """Load it, for the first run."""
        self._checked: Loaded | None = super()._load()

    def _load(self) -> Loaded:
        loaded, self._checked = self._checked, None
        return loaded or super()._load()

    def _prepare_thread(self) -> AbstractContextManager[None]:
        self._slept: set[str] = set()  # functions by which it has slept in real time
        if not crash_report.IS_SUPPORTED:
            return super()._prepare_thread()
        return traps.trap_thread(self._note_sleep, self._wait_for_thread)

    def _report_threads(self, n: int, code: int) -> None:
        self._board.link.fail(
            HostError(
                f"{self._path.name} has returned {code} while {n} of its threads still ran, at {self._board.stage.time:.6f} s: "
                "whatever they do or break, nobody would know. Join them before PULSESTAGE_MAIN returns."
            )
        )

    def _locate(self, *libraries: Path) -> str:
        pc, top = traps.find_position(self._thread) if crash_report.IS_SUPPORTED else (0, 0)
        return f" It is in {crash_report.locate(pc, top, *libraries)}." if pc else ""

    def _note_sleep(self, call: str) -> None:
        """Note in the log, once for each function and run, that firmware sleeps in real time. In the firmware's thread."""
        link, name = self._board.link, call.partition("(")[0]
        if name in self._slept or threading.current_thread() in link.abandoned:
            return
        self._slept.add(name)
        mode = requests.compute_as_usual.c()
        try:
            link.request(link.pointer, host_record.SETTLE, 0, 0)
            with suppress(StageError):  # the log is full
                self._board.note(f"{call} passes real time only, and no simulated time: ps_delay_us passes that")
        finally:
            requests.compute_as_before.c(mode)

    def _wait_for_thread(self) -> None:
        """Let a thread that the firmware has begun come to its first bus cycle, see `Link`. In the firmware's thread."""
        if self._board.link.record["looks"]:
            time.sleep(THREAD_START_S)


def adopt(ours: Stage, stage: Stage) -> None:
    """The parent's stage was changed: ours becomes like it. What drives have of it is state, and comes over as such."""
    for part, name, value in settings(stage.model):
        mine = ours.model if part is stage.model else ours.model.opt
        if isinstance(value, np.ndarray):
            np.copyto(getattr(mine, name), value)
        elif value != getattr(mine, name):
            setattr(mine, name, value)
    ours.state.switch_table[:] = stage.state.switch_table


def _unpickled(board: bytes) -> tuple[Any, dict[str, Any], list[Any]]:
    try:
        return pickle.loads(board)
    except Exception as error:
        raise StageError(
            f"the process of firmware with isolated=True cannot take over the stage: {error}. Define the classes of its chips and "
            "layouts in a module that it can import (not in a script), or run the firmware with isolated=False."
        ) from None


def _ends_with(parent: int, fileno: int, begun: list[Begin]) -> None:
    """This process ends when its parent does, however: firmware that computes, or whose end is far, looks at no pipe."""
    pipe = select.poll()
    pipe.register(fileno, 0)  # hanging up comes unasked
    while os.getppid() == parent:
        if pipe.poll(LOOK_MS):
            if _is_open(fileno):
                break
            time.sleep(LOOK_MS * 1e-3)  # the firmware has closed it: whoever sends next says so
    _tidy(begun)
    os._exit(0)


def _tidy(begun: list[Begin]) -> None:
    """The parent is gone, and may not have been able to remove its folder."""
    for begin in begun:
        shutil.rmtree(Path(begin.shared).parent, ignore_errors=True)


def _is_open(fileno: int) -> bool:
    try:
        os.fstat(fileno)
    except OSError:
        return False
    return True


def _out_of_the_way(fileno: int) -> int:
    """The pipe under a number that firmware hits less easily, and that programs which it starts do not have."""
    try:
        high = fcntl.fcntl(fileno, fcntl.F_DUPFD_CLOEXEC, HIGH)
    except OSError:  # not that many are allowed
        os.set_inheritable(fileno, False)
        return fileno
    os.close(fileno)
    return high


def _first_to_go() -> None:
    """Where memory is short, the system ends this process rather than one that has more to lose."""
    with suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:
        file.write("1000")


def main(fileno: int) -> None:
    """Run the firmware that comes over this end of a pipe, until the parent is gone."""
    fileno = _out_of_the_way(fileno)
    if crash_report.IS_SUPPORTED:
        traps.block_timers()
    begun: list[Begin] = []
    threading.Thread(target=_ends_with, args=(os.getppid(), fileno, begun), name="parent", daemon=True).start()
    _first_to_go()
    pipe = Connection(fileno)
    begin: Begin = pipe.recv()
    begun.append(begin)
    scratch.all_within(Path(begin.shared).parent)
    try:
        board = ChildBoard(pipe, begin)
        if crash_report.IS_SUPPORTED:
            traps.watch_crashes(board.link.shared.note_crash)
        pipe.send(LOADING)
        runner = ChildThread(begin.program, board, begin.patience)
    except StageError as error:
        pipe.send((type(error).__name__, str(error)))
        return
    try:
        _serve(pipe, board, runner)
    except EOFError:
        _tidy(begun)
        raise
    except OSError:
        board.link.shared.note_crash(crash_report.format_note(CLOSED))
        os._exit(1)
    except Exception:
        with suppress(SpoiltError):
            board.link.shared.check()
            raise
        os._exit(1)  # what it failed with means nothing; the parent sees it, too


def _serve(pipe: Connection, board: ChildBoard, runner: Threaded) -> None:
    """Let the firmware go on as the parent says."""
    pipe.send(None)
    while True:
        go: Go = pipe.recv()
        board.go(go)
        code, failure = None, None
        try:
            code = runner.go_on(go.until, go.most_cycles)
        except Exception as error:
            failure = (type(error).__name__, str(error))
        pipe.send(Stands(board.link.noted(), board.port_table, code, failure))
        if failure is not None:
            os._exit(1)
