"""Starts processes for firmware in milliseconds: one starter process has imported all that they need, and forks each of them.

    process = start(pipe)          the process runs stage.board.isolation.firmware_process, with this end of a pipe
    process.kill()
    process.wait()                 its exit code; minus the number of the signal that ended it

multiprocessing's forkserver is unsuitable: it imports the user's main module into each child, gives all children the environment
and the standard output that it had at its own start, and does not notice that a child was stopped.

The starter begins with the first child and ends with this process. A child has the standard output, environment, folder and
sys.path that this process has when the child starts.

The starter is the parent of firmware, which may harm it. A starter that has ended, is stopped or traced, or does not answer
within `ANSWER_LIMIT_S` is ended together with its children, and the next start creates another one.
"""

from __future__ import annotations

import atexit
import gc
import os
import pickle
import selectors
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from stage.board.thread_runner import read_process_status
from stage.native import COMPILED

_HEAD = struct.Struct("q")
_STATUS = struct.Struct("i")
ANSWER_LIMIT_S = 30.0  # real time; a starter imports all that children need before its first answer
_POLL_INTERVAL_S = 0.25  # between two checks whether a silent starter was stopped
_FILES = 4  # that go with a start: pipe, status, standard output, standard error
_lock = threading.Lock()
_pending_kills: deque[tuple[ProcessStarter, int]] = deque()
_starters: dict[tuple[int, str], ProcessStarter] = {}  # by process (a fork has its own), and what is loaded first
SANITIZER_ENVIRONMENT = {
    "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1",  # at its end the process does not tidy up, so all would be a leak
    "UBSAN_OPTIONS": "halt_on_error=1:print_stacktrace=1:abort_on_error=1",
    "TSAN_OPTIONS": "halt_on_error=1:abort_on_error=1",
}


class ChildEnvironment(NamedTuple):
    """Environment, working folder and sys.path with which a child process starts.

    Attributes:
        environment: Its environment variables.
        folder: Its working directory.
        path: Its sys.path.
    """

    environment: dict[str, str]
    folder: str
    path: list[str]


class ChildProcess:
    """A child of the starter.

    Attributes:
        pid: Process identifier.
        stopped: Number of the signal that stopped the child, so that it was ended; or 0.
    """

    def __init__(self, starter: ProcessStarter, status: socket.socket):
        self._starter, self._status = starter, status
        try:
            self.pid: int = _HEAD.unpack(starter.read(status, _HEAD.size))[0]
        except BaseException:
            status.close()
            raise
        starter.children.add(self.pid)
        self._code: int | None = None
        self.stopped = 0

    def kill(self) -> None:
        """End this child process, if it has not ended."""
        if self._code is None:
            self._starter.kill(self.pid)

    def release(self) -> None:
        """End this child process, if it has not ended, and close the connection to it: nobody is going to wait for it."""
        self.kill()
        self._status.close()

    def wait(self, limit_s: float = ANSWER_LIMIT_S) -> int:
        """Wait until the child ends. End it if it, or its starter, gives no sign for `limit_s` seconds of real time.

        Returns:
            Its exit code, or minus the number of the signal that ended it.
        """
        if self._code is None:
            try:
                status = self._read_status(limit_s)
                while os.WIFSTOPPED(status):
                    self.stopped = os.WSTOPSIG(status)
                    status = self._read_status(limit_s)
                self._code = os.waitstatus_to_exitcode(status)
            except (EOFError, OSError):  # the starter is gone, and its children with it
                self._starter.end()
                self._code = -signal.SIGKILL
            self._starter.children.discard(self.pid)
            self._status.close()
        return self._code

    def _read_status(self, limit_s: float) -> int:
        """Read the status of the child from its starter."""
        return int(_STATUS.unpack(self._starter.read(self._status, _STATUS.size, limit_s))[0])


class ProcessStarter:
    """Connection to the starter process, which forks the child processes of this process.

    Attributes:
        children: Identifiers of the children whose end nobody has waited for.
    """

    def __init__(self, preload: str = "") -> None:
        self._owner = os.getpid()
        self.children: set[int] = set()
        self._control, theirs = socket.socketpair()
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
            "OPENBLAS_NUM_THREADS": "1",  # a process that forks has one thread
        }
        if preload:
            environment = SANITIZER_ENVIRONMENT | environment | {"LD_PRELOAD": preload}
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "stage.board.isolation.process_starter", str(theirs.fileno())], pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL, process_group=0, env=environment,
            )  # fmt: skip

    def is_alive(self) -> bool:
        """Return whether the starter can answer requests: it has not ended, and no signal or tracer has stopped it."""
        return self._process.poll() is None and not _is_suspended(self._process.pid)

    def end(self) -> None:
        """End the starter and its children.

        In a fork of this process this does nothing, because they belong to the original process.
        """
        if os.getpid() != self._owner:
            return
        if self._process.poll() is None:
            parent = str(self._process.pid)
            for pid in tuple(self.children):
                # with another parent it has ended, and the number is another's
                if read_process_status(pid).get("PPid", parent) == parent:
                    _kill_child(pid)
            self._process.kill()
            self._process.wait()
        self._control.close()

    def read(self, source: socket.socket, size: int, limit_s: float = ANSWER_LIMIT_S) -> bytes:
        """Read bytes that the starter sends.

        Raises:
            EOFError: The starter has ended.
            TimeoutError: The starter was stopped, or has sent nothing for `limit_s` seconds of real time.
        """
        content, until = b"", time.monotonic() + limit_s
        source.settimeout(_POLL_INTERVAL_S)
        while len(content) < size:
            try:
                more = source.recv(size - len(content))
            except TimeoutError:
                if time.monotonic() < until and not _is_suspended(self._process.pid):
                    continue
                raise
            if not more:
                raise EOFError
            content += more
        return content

    def start(self, pipe: int) -> ChildProcess:
        """Start a child process that gets this end of a pipe."""
        context = ChildEnvironment(dict(os.environ), _find_working_folder(), list(sys.path))
        ours, theirs = socket.socketpair()
        with theirs:
            files = [pipe, theirs.fileno(), 1, 2]
            try:
                with _lock:
                    self.send(("start", context), files)
            except BaseException:
                ours.close()
                raise
            _send_kills()
        return ChildProcess(self, ours)

    def kill(self, pid: int) -> None:
        """Let the starter process end one of its children.

        An object that is collected as garbage may call this method at any moment, even while this thread sends a message; the
        order is then sent afterwards. In a fork of this process the method does nothing, because the children belong to the
        original process.
        """
        if os.getpid() != self._owner:
            return
        _pending_kills.append((self, pid))
        _send_kills()

    def send(self, message: Any, files: list[int]) -> None:
        """Send a message with open files to the starter process."""
        content = pickle.dumps(message)
        socket.send_fds(self._control, [_HEAD.pack(len(content))], files)
        self._control.sendall(content)


def _send_kills() -> None:
    """Send the orders of `kill`. While another thread holds the lock, that thread sends them after it has released the lock."""
    while _pending_kills and _lock.acquire(blocking=False):
        try:
            while _pending_kills:
                starter, pid = _pending_kills.popleft()
                with suppress(OSError):  # it is gone, and so are its children
                    starter.send(("kill", pid), [])
        finally:
            _lock.release()


def start(pipe: int, preload: str = "") -> ChildProcess:
    """Start a process that runs `stage.board.isolation.firmware_process` with this end of a pipe.

    Args:
        pipe: File descriptor that the process gets.
        preload: Libraries that are loaded first.

    Raises:
        OSError, EOFError: Neither the starter nor a second one can start a process.
    """
    try:
        return _find_starter(preload).start(pipe)
    except (EOFError, TimeoutError, BrokenPipeError, ConnectionResetError):
        _find_starter(preload, silent=True)
    return _find_starter(preload).start(pipe)


def _find_starter(preload: str, silent: bool = False) -> ProcessStarter:
    """Return the process starter of this process. Create one if there is none, or if the present one is `silent`."""
    key = os.getpid(), preload
    with _lock:
        starter = _starters.get(key)
        if starter is not None and (silent or not starter.is_alive()):
            starter.end()
            starter = None
        if starter is None:
            starter = _starters[key] = ProcessStarter(preload)
    _send_kills()
    return starter


@atexit.register
def _end_starters() -> None:
    """End the starters of this process. One that a signal has suspended would not notice that this process ends."""
    for (owner, _), starter in _starters.items():
        if owner == os.getpid():
            starter.end()


def _is_suspended(pid: int) -> bool:
    """Return whether a signal or a tracer has suspended a process; False if the system does not tell."""
    return read_process_status(pid).get("State", "")[:1] in ("T", "t")


def _find_working_folder() -> str:
    """Return the working directory, or a folder that exists if it was removed."""
    try:
        return str(Path.cwd())
    except OSError:
        return "/"


def _read_exactly(source: socket.socket, size: int) -> bytes:
    """Read `size` bytes. Raises EOFError if the other end is closed."""
    content = b""
    while len(content) < size:
        more = source.recv(size - len(content))
        if not more:
            raise EOFError
        content += more
    return content


# --- the starter itself ---


def _fork_on_request(control: socket.socket, run: Callable[[int], None]) -> None:
    """Fork and end child processes on request, and report ended ones, until the other end of the socket is closed."""
    reader, writer = socket.socketpair()
    reader.setblocking(False)
    writer.setblocking(False)
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # firmware may send it to its parent
    children: dict[int, socket.socket] = {}
    with selectors.DefaultSelector() as selector:
        selector.register(control, selectors.EVENT_READ)
        selector.register(reader, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fileobj is reader:
                    reader.recv(4096)
                    _report_children(children)
                    continue
                head, files, _, _ = socket.recv_fds(control, _HEAD.size, _FILES)
                if not head:
                    return
                what, argument = pickle.loads(_read_exactly(control, _HEAD.unpack(head)[0]))
                if what == "kill":
                    if argument in children:
                        _kill_child(argument)
                    continue
                pid = os.fork()
                if not pid:
                    for other in (control, reader, writer, *children.values()):
                        other.close()
                    _become_child(argument, files, run)
                pipe, status, *streams = files
                for file in (pipe, *streams):
                    os.close(file)
                children[pid] = socket.socket(fileno=status)
                children[pid].send(_HEAD.pack(pid))


def _report_children(children: dict[int, socket.socket]) -> None:
    """Report child processes that have ended or are stopped to those who wait for them, and end the stopped ones."""
    while children:
        pid, status = os.waitpid(-1, os.WNOHANG | os.WUNTRACED)
        if not pid:
            return
        stopped = os.WIFSTOPPED(status)
        if pid not in children:  # a thread of firmware that has called ptrace(PTRACE_TRACEME)
            pid = int(read_process_status(pid).get("Tgid", 0)) if stopped else 0
        if pid not in children:
            continue
        _kill_child(pid, ended=not stopped)  # and what the firmware has started
        with suppress(OSError):  # nobody waits any more
            children[pid].send(_STATUS.pack(status))
        if not stopped:
            children.pop(pid).close()


def _kill_child(pid: int, ended: bool = False) -> None:
    """Kill the process group of a child, and the child itself unless it has already ended."""
    with suppress(OSError):
        os.killpg(pid, signal.SIGKILL)
    if not ended:
        with suppress(OSError):
            os.kill(pid, signal.SIGKILL)


def _become_child(context: ChildEnvironment, files: list[int], run: Callable[[int], None]) -> None:
    """Turn this forked process into a child that runs firmware, and exit when the firmware has ended."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a terminal's Ctrl-C does not reach its group
        os.setpgid(0, 0)
        pipe, status, *streams = files
        os.close(status)
        for file, number in zip(streams, (1, 2), strict=True):
            os.dup2(file, number)
            os.close(file)
        os.environ.clear()
        os.environ.update(context.environment)
        os.chdir(context.folder)
        sys.path[:] = context.path
        run(pipe)
        code = 0
    except (EOFError, BrokenPipeError):
        code = 0  # the parent is gone
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        os._exit(code)


def main(fileno: int) -> None:
    """Run the starter process, which forks children that run firmware, with this end of a socket."""
    from stage.board.isolation import firmware_process
    from stage.sim import engine

    if COMPILED:
        _ = engine.set_switch_levels.address  # loads and checks the native library once for all children
    gc.freeze()
    with socket.socket(fileno=fileno) as control:
        _fork_on_request(control, firmware_process.main)


if __name__ == "__main__":
    main(int(sys.argv[1]))
