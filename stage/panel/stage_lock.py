"""`StageLock`: the lock of a stage that several threads share. Fair, re-entrant, and it can be reserved for one thread.

    with lock:                 first come, first served; a thread that has it may enter again
        lock.wait(0.02)        somebody else may have it for so long, or until `wake_all()`

Python's RLock alone is not fair: a thread in a loop of bus cycles takes it again before those that wait have woken up. So whoever
does not get it at once waits in a line, and nobody takes it past the line. Without a line it costs little more than RLock does.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition, RLock, get_ident
from time import monotonic

from stage.errors import StageError


class StageLock:
    """Fair re-entrant lock. Times are in real seconds."""

    def __init__(self) -> None:
        ownership = RLock()
        self._try_to_own, self._disown = ownership.acquire, ownership.release
        self._depth = 0  # how often the owner has entered; belongs to the owner
        self._is_open = True  # nobody waits, and it is reserved for nobody: it may be taken without a look at the line
        self._mutex = RLock()  # of all below; re-entrant, for signal handlers that interrupt a thread within it
        self._line, self._pause = Condition(self._mutex), Condition(self._mutex)
        self._waiting: list[int] = []  # identifiers of threads, in the order in which they came
        self._reserved_for, self._refusal = 0, ""  # identifiers of threads are not 0
        self._acting: set[int] = set()
        self._without_ownership: set[int] = set()  # threads that may leave what they have not got

    def __enter__(self) -> StageLock:
        if self._try_to_own(False):
            if self._depth or self._is_open:
                self._depth += 1
                return self
            self._disown()
        self._wait_for_turn(1, None)
        return self

    def __exit__(self, *exc: object) -> None:
        if self._without_ownership and get_ident() in self._without_ownership and not self.is_held():
            return
        self._depth = depth = self._depth - 1
        self._disown()
        if not (depth or self._is_open):
            self._wake_line()

    def acquire(self, timeout: float | None = None) -> bool:
        """Wait for the lock, for `timeout` seconds at most where it is given, and return whether this thread has it.

        Raises:
            StageError: The lock is reserved for another thread, and `reserve` said why all others are refused.
        """
        return self._wait_for_turn(1, timeout)

    def release(self) -> None:
        """Leave; the thread that has waited longest is next."""
        self.__exit__()

    def wait(self, timeout: float | None = None) -> None:
        """Give the lock away until `timeout` seconds have passed or somebody calls `wake_all`, then wait for it again.

        Raises:
            StageError: As `acquire`. After it, and after Ctrl-C, this thread has not got the lock; to leave it does nothing then.
        """
        with self._mutex:
            depth = self._give_away()
            self._without_ownership.add(get_ident())
            self._pause.wait(timeout)
            self._wait_for_turn(depth, None)
            self._without_ownership.discard(get_ident())

    def give_way(self) -> None:
        """Let those that wait have the lock first."""
        if self._waiting:
            self.wait(0)

    def wake_all(self) -> None:
        """End every `wait`. For signal handlers, too."""
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
            self.wake_all()

    def is_held(self) -> bool:
        """Return whether this thread has the lock."""
        if not self._try_to_own(False):
            return False
        held = self._depth > 0
        self._disown()
        return held

    @property
    def has_waiting(self) -> bool:
        """Whether some thread waits for the lock."""
        return bool(self._waiting)

    def release_all(self) -> None:
        """Free the lock where this thread has it, however often it entered: an interrupt may have ended it while it left."""
        if self.is_held():
            with self._mutex:
                self._give_away()

    @contextmanager
    def acting_for_owner(self) -> Iterator[None]:
        """Let this thread act for the one that has the lock and waits for this thread, as a host waits for its firmware."""
        me = get_ident()
        if self.is_held():
            yield
            return
        self._acting.add(me)
        self._without_ownership.add(me)
        try:
            yield
        finally:
            self._acting.discard(me)
            self._without_ownership.discard(me)

    def _wake_line(self) -> None:
        with self._mutex:
            self._line.notify_all()

    def _wait_for_turn(self, depth: int, timeout: float | None) -> bool:
        """Take the lock `depth` times when it is this thread's turn; return whether that was in time."""
        me, end = get_ident(), None if timeout is None else monotonic() + timeout
        if me in self._acting:
            return True
        if self.is_held():
            self._take_new(depth)
            return True
        with self._mutex:
            self._waiting.append(me)
            self._update()
            try:
                while not (self._is_next(me) and self._try_to_own(False)):
                    if self._refusal and me != self._reserved_for:
                        raise StageError(self._refusal)
                    left = None if end is None else end - monotonic()
                    if left is not None and left <= 0:
                        return False
                    self._line.wait(left)
                self._take_new(depth)
                self._disown()
                return True
            finally:
                self._waiting.remove(me)
                self._update()
                self._line.notify_all()

    def _is_next(self, me: int) -> bool:
        return me == (self._reserved_for or self._waiting[0])

    def _take_new(self, depth: int) -> None:
        for _ in range(depth):
            self._try_to_own()
        self._depth += depth

    def _give_away(self) -> int:
        """Free the lock, and return how often this thread had entered."""
        depth, self._depth = self._depth, 0
        for _ in range(depth):
            self._disown()
        self._line.notify_all()
        return depth

    def _update(self) -> None:
        self._is_open = not (self._waiting or self._reserved_for)
