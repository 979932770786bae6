"""`ProcedureSchedule`: procedures of a host that go on while other code lets simulated time pass, several at once on one machine.

A procedure is plain blocking code: bus cycles, and waits that let time pass. It runs in a thread of its own, but only while the
thread that lets time pass waits for it, so exactly one thread uses the machine at any moment and runs repeat bit by bit.

    thread that lets time pass     procedure of x                procedure of y
    begin(x) --------------------> bus cycles, wait 1 ms
    <------------------------------ |
    begin(y) ------------------------------------------------> bus cycles, wait 2 ms
    <------------------------------------------------------------|
    run(3 ms): 1 ms passes
             --------------------> bus cycles, wait 1 ms
    ...

A wait that is shorter than MIN_WAIT_NS passes at once, without another procedure in between: such waits belong to sequences of bus
cycles with exact times. A bus cycle never lets another procedure go on, so numbers of several bytes stay whole.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

MIN_WAIT_NS = 50_000
MAX_DELAY_NS = 1_000_000
"""Time after which a procedure goes on even if the machine's time passes in pieces shorter than MIN_WAIT_NS."""


class ProcedureCancelled(BaseException):
    """Signal that ends a cancelled procedure at its wait. No `except Exception` of a procedure catches it."""


class ProcedureThread:
    """Procedure under way in a thread of its own. `ProcedureSchedule.begin` makes it.

    Attributes:
        axis_name: Name of the axis that the procedure moves.
        name: Name of the procedure, for people.
        is_done: Whether the procedure has ended.
        was_cancelled: Whether `cancel` has ended it.
        result: Result of the procedure; None before its end.
        error: Error of the procedure, or None.
        resume_at: Simulated time at which the procedure goes on, ns.
    """

    def __init__(self, schedule: ProcedureSchedule, axis_name: str, name: str, run: Callable[[], Any]):
        self.axis_name, self.name, self.is_done, self.was_cancelled = axis_name, name, False, False
        self.result: Any = None
        self.error: BaseException | None = None
        self.resume_at = 0
        self._schedule, self._run, self._cancelling = schedule, run, False
        # each is free for one turn: cheaper than a Semaphore
        self._may_run, self._has_paused = threading.Lock(), threading.Lock()
        self._may_run.acquire()
        self._has_paused.acquire()
        self._thread = threading.Thread(target=self._run_procedure, daemon=True, name=f"{name} {axis_name}")
        self._thread.start()

    def resume(self) -> None:
        """Let the procedure of this thread go on up to its next wait or its end."""
        self._schedule.running = self
        self._may_run.release()
        try:
            self._has_paused.acquire()
        except BaseException:  # Ctrl-C: the procedure first reaches its next wait
            self._has_paused.acquire()
            raise
        finally:
            self._schedule.running = None

    def wait_until(self, now: int, until: int) -> None:
        """Wait in the procedure's own thread until its turn at a later time; a wait shorter than MIN_WAIT_NS returns at once.

        Args:
            now: Simulated time, ns.
            until: Time of the next turn, ns.

        Raises:
            ProcedureCancelled: Another thread has cancelled the procedure.
        """
        if until - now < MIN_WAIT_NS:
            return
        self.resume_at = until
        self._permission.__exit__(None, None, None)
        self._has_paused.release()
        self._take_turn()

    def cancel(self) -> None:
        """End the procedure at the wait in which it is. The chip continues what it does."""
        if not self.is_done:
            self._cancelling = True
            self.resume()
            self._schedule.remove(self)

    def _take_turn(self) -> None:
        self._may_run.acquire()
        lock = getattr(self._schedule.machine, "lock", None)
        self._permission: Any = nullcontext() if lock is None else lock.act_for_owner()
        self._permission.__enter__()
        if self._cancelling:
            raise ProcedureCancelled

    def _run_procedure(self) -> None:
        try:
            self._take_turn()
            self.result = self._run()
        except ProcedureCancelled:
            self.was_cancelled = True
        except BaseException as error:
            self.error = error
        self.is_done = True
        self._permission.__exit__(None, None, None)
        del self._run
        self._has_paused.release()


class ProcedureSchedule:
    """Procedures under way on one machine.

    Args:
        machine: Loop of a stage, or bench, whose time the procedures share.

    Attributes:
        running: Procedure whose turn it is; None while the thread that lets time pass runs.
        waiting: Procedures that wait for a time.
    """

    def __init__(self, machine: Any):
        self.machine = machine
        self.running: ProcedureThread | None = None
        self.waiting: list[ProcedureThread] = []
        self._last_now = 0

    def find(self, axis_name: str) -> ProcedureThread | None:
        """Return the procedure under way of an axis, or None."""
        threads = self.waiting if self.running is None else [*self.waiting, self.running]
        return next((thread for thread in threads if thread.axis_name == axis_name), None)

    def begin(self, axis_name: str, name: str, run: Callable[[], Any], now: int) -> ProcedureThread:
        """Begin a procedure: it runs up to its first wait.

        Args:
            axis_name: Name of the axis that the procedure moves.
            name: Name of the procedure, for people.
            run: The procedure.
            now: Simulated time, ns.
        """
        thread = ProcedureThread(self, axis_name, name, run)
        if not self.waiting:
            self._last_now = now
        thread.resume()
        if not thread.is_done:
            self.waiting.append(thread)
        return thread

    def remove(self, thread: ProcedureThread) -> None:
        """Remove a procedure that has ended."""
        if thread in self.waiting:
            self.waiting.remove(thread)

    def is_overdue(self, now: int) -> bool:
        """Return whether a procedure has waited for MAX_DELAY_NS too long, and no procedure has its turn. `now` is in ns."""
        return self.running is None and any(now - thread.resume_at > MAX_DELAY_NS for thread in self.waiting)

    def resume_due_procedures(self, now: int, until: int) -> int:
        """Let the procedures go on that are due, and return the time up to which the machine's time may pass now, ns.

        A time that has gone back, because another state has been loaded, ends all procedures.

        Args:
            now: Simulated time, ns.
            until: Time that the caller wants to reach, ns.
        """
        if now < self._last_now:
            self.cancel_all()
        self._last_now = now
        for thread in sorted((t for t in self.waiting if t.resume_at <= now), key=lambda t: t.resume_at):
            thread.resume()
            if thread.is_done:
                self.remove(thread)
        return min(
            (max(thread.resume_at, now + 1) for thread in self.waiting if thread.resume_at < until), default=until
        )

    def cancel_all(self) -> None:
        """End all procedures of the machine at the waits in which they are."""
        for thread in tuple(self.waiting):
            thread.cancel()
