"""`FairStageLock`: a lock for a stage that several threads use. It is fair and re-entrant, and can be reserved for one thread.

    with lock:                 first come, first served; a thread that holds the lock may enter again
        lock.wait(0.02)        other threads may hold it for 20 ms, or until `notify_all()`

Python's RLock alone is not fair: a thread in a loop of bus cycles takes it again before waiting threads have woken up. With this
lock, a thread that must wait joins a line, and no thread overtakes the line. Without a line, it costs little more than an RLock.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Condition, RLock, get_ident
from time import monotonic

from stage.errors import StageError


class FairStageLock:
    """Fair, re-entrant lock of a stage, which can be reserved for one thread. Times are in real seconds."""

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

    def __enter__(self) -> FairStageLock:
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
            with self._mutex:
                self._line.notify_all()

    def acquire(self, timeout: float | None = None) -> bool:
        """Wait for the lock.

        Args:
            timeout: Longest wait, real seconds; None: no limit.

        Returns:
            Whether this thread holds the lock now.

        Raises:
            StageError: The lock is reserved for another thread, and `reserve` has set a refusal for all others.
        """
        return self._wait_for_turn(1, timeout)

    def release(self) -> None:
        """Release the lock once. After as many releases as acquisitions, the thread that has waited longest is next."""
        self.__exit__()

    def wait(self, timeout: float | None = None) -> None:
        """Release the lock for other threads, then wait for it again.

        Args:
            timeout: Real seconds for which others may hold the lock; None: no limit. `notify_all` ends this time early.

        Raises:
            StageError: The lock is refused as in `acquire`. After this error, and after Ctrl-C, this thread does not hold the
                lock, and `release` then does nothing.
        """
        with self._mutex:
            depth = self._release_all_levels()
            self._exempt.add(get_ident())
            self._pause.wait(timeout)
            self._wait_for_turn(depth, None)
            self._exempt.discard(get_ident())

    def yield_to_waiting(self) -> None:
        """Let the threads that wait for the lock hold it first."""
        if self._waiting:
            self.wait(0)

    def notify_all(self) -> None:
        """End the `wait` of all threads. Signal handlers may call this method."""
        with self._mutex:
            self._pause.notify_all()
            self._line.notify_all()

    def reserve(self, thread: int, refusal: str = "") -> None:
        """Reserve the lock for one thread from now on. A thread that holds the lock keeps it until it releases it.

        Args:
            thread: Identifier of the thread; 0: the lock is no longer reserved.
            refusal: Text of the error that other threads get from `acquire`; "": they wait.
        """
        with self._mutex:
            self._reserved_for, self._refusal = thread, refusal
            self._update_fast_path()
            self.notify_all()

    def is_acquired(self) -> bool:
        """Return whether this thread holds the lock."""
        if not self._acquire(False):
            return False
        is_acquired = self._depth > 0
        self._release()
        return is_acquired

    @property
    def has_waiting(self) -> bool:
        """True if another thread waits for the lock."""
        return bool(self._waiting)

    def release_all(self) -> None:
        """Release the lock completely if this thread holds it, even if an interrupt has cut `acquire` or `release` short."""
        if not self._acquire(False):
            return
        with self._mutex:
            self._depth = 0
            with suppress(RuntimeError):  # it is free
                while True:
                    self._release()
            self._line.notify_all()

    @contextmanager
    def act_for_owner(self) -> Iterator[None]:
        """Let this thread act as the thread that holds the lock and waits for this one, as a host waits for its firmware."""
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

    def _wait_for_turn(self, depth: int, timeout: float | None) -> bool:
        """Acquire the lock `depth` times when it is this thread's turn; return False if that was not before `end`."""
        me, end = get_ident(), None if timeout is None else monotonic() + timeout
        if me in self._acting:
            return True
        if self.is_acquired():
            self._acquire_levels(depth)
            return True
        with self._mutex:
            self._waiting.append(me)
            self._update_fast_path()
            try:
                while not (self._is_turn_of(me) and self._acquire(False)):
                    if self._refusal and me != self._reserved_for:
                        raise StageError(self._refusal)
                    left = None if end is None else end - monotonic()
                    if left is not None and left <= 0:
                        return False
                    self._line.wait(left)
                self._acquire_levels(depth)
                self._release()
                return True
            finally:
                self._waiting.remove(me)
                self._update_fast_path()
                self._line.notify_all()

    def _is_turn_of(self, me: int) -> bool:
        return me == (self._reserved_for or self._waiting[0])

    def _acquire_levels(self, depth: int) -> None:
        """Acquire the free lock `depth` times."""
        for _ in range(depth):
            self._acquire()
        self._depth += depth

    def _release_all_levels(self) -> int:
        """Release the lock completely, and return how often this thread had acquired it."""
        depth, self._depth = self._depth, 0
        for _ in range(depth):
            self._release()
        self._line.notify_all()
        return depth

    def _update_fast_path(self) -> None:
        """Let `acquire` skip the line while no thread waits and the lock is not reserved."""
        self._is_open = not (self._waiting or self._reserved_for)
