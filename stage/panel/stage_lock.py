"""`StageLock`: the lock of a stage that several threads share. Fair, re-entrant, and it can be reserved for one thread.

    with lock:                 first come, first served; a thread that has it may enter again
        lock.wait(0.02)        somebody else may have it for so long, or until `notify_all()`

Python's RLock alone is not fair: a thread in a loop of bus cycles takes it again before those that wait have woken up. So whoever
does not get it at once waits in a line, and nobody takes it past the line. Without a line it costs little more than RLock does.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Condition, RLock, get_ident
from time import monotonic

from stage.errors import StageError


class StageLock:
    """Fair re-entrant lock. Times are in real seconds."""

    def __init__(self) -> None:
        lock = RLock()
        self._acquire, self._release = lock.acquire, lock.release
        self._depth = 0  # how often the owner has entered; belongs to the owner
        self._is_open = True  # nobody waits, and it is reserved for nobody: it may be taken without a look at the line
        self._mutex = RLock()  # of all below; re-entrant, for signal handlers that interrupt a thread within it
        self._line, self._pause = Condition(self._mutex), Condition(self._mutex)
        self._waiting: list[int] = []  # identifiers of threads, in the order in which they came
        self._reserved_for, self._refusal = 0, ""  # identifiers of threads are not 0
        self._acting: set[int] = set()
        self._exempt: set[int] = set()  # threads that may leave though they have not got the lock

    def __enter__(self) -> StageLock:
        if self._acquire(False):
            if self._depth or self._is_open:
                self._depth += 1
                return self
            self._release()
        self._wait_for_turn(1, None)
        return self

    def __exit__(self, *exc: object) -> None:
        if self._exempt and get_ident() in self._exempt and not self.is_acquired():
            return
        self._depth = depth = self._depth - 1
        self._release()
        if not (depth or self._is_open):
            self._notify_line()

    def acquire(self, timeout: float | None = None) -> bool:
        """Wait for the lock.

        Args:
            timeout: Real seconds to wait at most; None: without end.

        Returns:
            Whether this thread has it.

        Raises:
            StageError: The lock is reserved for another thread, and `reserve` said why all others are refused.
        """
        return self._wait_for_turn(1, timeout)

    def release(self) -> None:
        """Leave; the thread that has waited longest is next."""
        self.__exit__()

    def wait(self, timeout: float | None = None) -> None:
        """Give the lock away for a time, then wait for it again.

        Args:
            timeout: Real seconds until then; it ends earlier where somebody calls `notify_all`.

        Raises:
            StageError: As `acquire`. After it, and after Ctrl-C, this thread has not got the lock; to leave it does nothing then.
        """
        with self._mutex:
            depth = self._give_away()
            self._exempt.add(get_ident())
            self._pause.wait(timeout)
            self._wait_for_turn(depth, None)
            self._exempt.discard(get_ident())

    def yield_to_waiting(self) -> None:
        """Let those that wait have the lock first."""
        if self._waiting:
            self.wait(0)

    def notify_all(self) -> None:
        """End every `wait`. Signal handlers may call it."""
        with self._mutex:
            self._pause.notify_all()
            self._line.notify_all()

    def reserve(self, thread: int, refusal: str = "") -> None:
        """Keep the lock for the thread of this identifier from now on; 0: for none. Whoever has it keeps it until it leaves.

        Args:
            thread: Identifier of a thread.
            refusal: Text of the error that other threads get; "": they wait.
        """
        with self._mutex:
            self._reserved_for, self._refusal = thread, refusal
            self._update()
            self.notify_all()

    def is_acquired(self) -> bool:
        """Return whether this thread has the lock."""
        if not self._acquire(False):
            return False
        is_acquired = self._depth > 0
        self._release()
        return is_acquired

    @property
    def has_waiting(self) -> bool:
        """Presence of a thread that waits for the lock."""
        return bool(self._waiting)

    def release_all(self) -> None:
        """Free the lock where this thread has it, also where an interrupt has left it half entered or half left."""
        if not self._acquire(False):
            return
        with self._mutex:
            self._depth = 0
            with suppress(RuntimeError):  # it is free
                while True:
                    self._release()
            self._line.notify_all()

    @contextmanager
    def acting_for_owner(self) -> Iterator[None]:
        """Let this thread act for the one that has the lock and waits for this thread, as a host waits for its firmware."""
        me = get_ident()
        if self.is_acquired():
            yield
            return
        self._acting.add(me)
        self._exempt.add(me)
        try:
            yield
        finally:
            self._acting.discard(me)
            self._exempt.discard(me)

    def _notify_line(self) -> None:
        with self._mutex:
            self._line.notify_all()

    def _wait_for_turn(self, depth: int, timeout: float | None) -> bool:
        """Take the lock `depth` times when it is this thread's turn; return whether that was in time."""
        me, end = get_ident(), None if timeout is None else monotonic() + timeout
        if me in self._acting:
            return True
        if self.is_acquired():
            self._take_new(depth)
            return True
        with self._mutex:
            self._waiting.append(me)
            self._update()
            try:
                while not (self._is_next(me) and self._acquire(False)):
                    if self._refusal and me != self._reserved_for:
                        raise StageError(self._refusal)
                    left = None if end is None else end - monotonic()
                    if left is not None and left <= 0:
                        return False
                    self._line.wait(left)
                self._take_new(depth)
                self._release()
                return True
            finally:
                self._waiting.remove(me)
                self._update()
                self._line.notify_all()

    def _is_next(self, me: int) -> bool:
        return me == (self._reserved_for or self._waiting[0])

    def _take_new(self, depth: int) -> None:
        for _ in range(depth):
            self._acquire()
        self._depth += depth

    def _give_away(self) -> int:
        """Free the lock, and return how often this thread had entered."""
        depth, self._depth = self._depth, 0
        for _ in range(depth):
            self._release()
        self._line.notify_all()
        return depth

    def _update(self) -> None:
        self._is_open = not (self._waiting or self._reserved_for)
