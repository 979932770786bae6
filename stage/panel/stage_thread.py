"""`StageThread`: the worker thread that owns the stage of a session. No page.

It lets time pass in slices of SLICE_S real seconds, and carries out the orders of other threads between two slices:

    thread.do(lambda stage: stage.axes["x"].chip.read(0))                     an order, which takes no time of its own
    thread.act("home x", lambda stage: firmware.home(stage.axes["x"]))        an action: as an order, but it lets time pass

While an action lets time pass, orders are carried out in its waits. Cutting time into slices changes no bit of what a stage does.

Every user of the stage takes `lock` (stage.panel.stage_lock, stage.chips.exclusive_access). There are two modes:

- The worker drives: time passes by it, the lock is reserved for it, and other threads wait or are refused.
- A program drives, from threads of its own: time passes by its calls alone. Each call has the lock from its first bus cycle to its
  last, and gives it away where time passes (`_pace_program`); there the worker carries out orders and calls the observers.

    program          worker
    lock             |
    | bus cycles     | waits for an order
    | wait 10 ms ----> lock, order, observe
    lock <------------ |
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from stage.errors import SimulationError, StageError
from stage.panel.real_time_clock import MAX_LAG_S, SLICE_S, RealTimeClock
from stage.panel.snapshot_history import SnapshotHistory
from stage.panel.stage_lock import StageLock
from stage.sim.axis import Axis
from stage.sim.stage import Stage
from stage.units import POSITION_UNITS

T = TypeVar("T")
Order = Callable[[Stage], Any]

MAX_BUS_CYCLE_NS = 50_000  # a shorter time is a bus cycle: no order comes between the bytes of a number
MAX_UNPACED_NS = (
    1_000_000  # waits that are shorter together are not paced, and carry out no orders; as those shorter than a slice
)
AFTERGLOW_S = 0.1  # real seconds for which observers are called after a program's last change: slow ones see its end
IDLE_INTERVAL_S = 0.5  # real seconds between two views of a worker that rests
MAX_PENETRATION = 0.1  # part of the travel: MuJoCo's end stops are soft, and a hard blow goes in by 3 % of the travel
SESSION_OVER = "this session is over."
NOT_YOURS = "this stage lives in a session: give it orders, session.do(...)."


def has_end_limits(axis: Axis) -> bool:
    """Return whether an axis has end limits, with stops behind them; a table that turns without end has none."""
    return any(switch.pin.startswith("el") for switch in axis.plant.switches)


def describe_escape(stage: Stage) -> str:
    """Return which carriage has gone through its end stop, and how far, in words; "" where none has."""
    for axis in stage.axes.values():
        if not has_end_limits(axis):
            continue
        position, (low, high) = float(stage.data.qpos[axis.plant.qpos]), axis.travel
        margin = MAX_PENETRATION * (high - low)
        if not low - margin <= position <= high + margin:
            place = POSITION_UNITS[axis.unit]
            return (
                f"{axis.name} is out of its travel, at {place.format(position, '.4g')}: its end stops are at "
                f"{place.format(low, 'g')} and {place.format(high, 'g')}. Take the cause away, and go back to a good state."
            )
    return ""


class ActionStopped(StageError):
    """Error of an action that somebody has stopped, or whose program or session has ended."""


@dataclass(frozen=True)
class StageView:
    """View of the stage after a slice.

    Attributes:
        number: Number of views so far.
        time: Simulated seconds.
        achieved_speed: Simulated seconds in a real second of late.
        action: Name of the action under way, or "".
        trouble: Why time stands still though nobody paused, or "".
        qpos: Positions of the joints, as MjData has them.
    """

    number: int
    time: float
    achieved_speed: float
    action: str
    trouble: str
    qpos: np.ndarray


@dataclass
class Action:
    """A procedure that waits for the worker, or is under way."""

    name: str
    run: Order
    future: Future
    stopped: bool = False


class StageThread:
    """Owns a stage from now until `close`; the methods may be called from any thread.

    Args:
        stage: A stage that has no session.
        speed: Simulated seconds in a real second; FREE: as fast as it goes.
        paused: Begin with time standing still.
        program: Name of the program that drives the stage, for people; "": the worker drives.

    Attributes:
        stage: The stage.
        lock: What every user of the stage takes.
        changed: Condition that is notified after each slice and each order.
        view: View after the last slice.
        program, program_suspended: See `Session`.
    """

    def __init__(self, stage: Stage, *, speed: float = 1.0, paused: bool = False, program: str = ""):
        if stage.loop.lock is not None:
            raise StageError("this stage has a session already: close that one first.")
        self.stage, self.program, self.program_suspended = stage, program, False
        self.lock, self.changed = StageLock(), threading.Condition()
        self._clock, self._history = RealTimeClock(speed, stage.now), SnapshotHistory()
        self._paused, self._trouble = paused, ""
        self._closed = self._ending = self._unpaced = self._jumped = False
        self._work = threading.Condition()  # its lock is re-entrant: signal handlers may interrupt a thread that has it
        self._has_work = False
        self._orders: deque[tuple[Order, Future]] = deque()
        self._actions: deque[Action] = deque()
        self._acting: Action | None = None
        self._last_action: Future | None = None
        self._observers: tuple[Order, ...] = ()
        self.view = StageView(0, stage.time, speed, "", "", np.array(stage.data.qpos))
        self._view_now, self._changed_at, self._polled_at = -1, 0.0, stage.now
        self._words = stage.state.words
        self._thread = threading.Thread(target=self._run, name="pulsestage session", daemon=True)
        self._started = threading.Event()
        self._thread.start()
        self._started.wait()

    # --- orders, from any thread ---

    def do(self, order: Callable[[Stage], T], timeout: float | None = None) -> T:
        """Have the worker call `order(stage)` between two slices.

        Orders are short: bus cycles, a few values. A thread that has the stage's lock calls it itself, at once.

        Args:
            order: Function of the stage.
            timeout: Real seconds to wait.

        Returns:
            The result of `order`.

        Raises:
            StageError: The session is over; or an error of `order`.
            TimeoutError: It was not done in time.
        """
        return order(self.stage) if self.lock.is_acquired() else self.post(order).result(timeout)

    def post(self, order: Callable[[Stage], T]) -> Future[T]:
        """Order as `do`, without waiting."""
        future: Future[T] = Future()
        with self._work:
            self._check_open()
            self._orders.append((order, future))
            self._notify()
        return future

    def act(self, name: str, run: Callable[[Stage], T]) -> Future[T]:
        """Have the worker call `run(stage)`, which lets time pass; actions come one after the other.

        Args:
            name: Name of the action, for people.
            run: Function of the stage, for example a procedure of stage.firmware.

        Returns:
            Future of its result.

        Raises:
            StageError: The session is over.
        """
        action = Action(name, run, Future())
        with self._work:
            self._check_open()
            self._last_action = action.future
            self._actions.append(action)
            self._notify()
        return action.future

    def stop_actions(self) -> bool:
        """End the action under way where it is, and those that wait: they raise ActionStopped. The chips go on.

        Returns:
            Whether there was an action under way.
        """
        with self._work:
            acting, waiting = self._acting, list(self._actions)
            self._actions.clear()
            if acting is not None:
                acting.stopped = True
            self._notify()
        for action in waiting:
            if action.future.set_running_or_notify_cancel():
                action.future.set_exception(ActionStopped("stopped."))
        return acting is not None

    @property
    def busy(self) -> bool:
        """State of the actions: one is under way, or waits for its turn."""
        last = self._last_action
        return last is not None and not last.done()

    def on_slice(self, observer: Order) -> Callable[[], None]:
        """Have the worker call `observer(stage)` after each slice; return a function that ends it."""
        with self._work:
            self._observers = (*self._observers, observer)

        def end() -> None:
            with self._work:
                self._observers = tuple(o for o in self._observers if o is not observer)

        return end

    def close(self) -> None:
        """End, and give the stage back to its caller as it is; orders and actions that wait get a StageError."""
        with self._work:
            self._closed = True
        self._notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _check_open(self) -> None:
        if self._closed:
            raise StageError(SESSION_OVER)

    def _notify_all(self) -> None:
        """Make all threads that wait check their conditions again."""
        self._notify()
        self.lock.notify_all()

    def _notify(self) -> None:
        """Wake the worker."""
        with self._work:
            self._has_work = True
            self._work.notify_all()

    # --- the worker ---

    def _run(self) -> None:
        loop = self.stage.loop
        self._identifier = threading.get_ident()
        self._share(self.lock)
        loop.pace = self._pace
        self._reserve()
        self._started.set()
        try:
            while not self._closed:
                (self._drive if self._drives() else self._observe_program)()
        finally:
            loop.pace = None
            self._share(None)
            self.lock.reserve(0)
            self._refuse_waiting()

    def _share(self, lock: StageLock | None) -> None:
        self.stage.loop.lock = lock
        for chip in self.stage.chips:
            chip.share(lock)

    def _reserve(self) -> None:
        """Reserve the lock for the worker where it drives; refuse all other threads where there is no program."""
        drives = self._drives() and not self._closed
        self.lock.reserve(self._identifier if drives else 0, "" if self.program or not drives else NOT_YOURS)
        self._notify_all()

    def _drives(self) -> bool:
        """Return whether time passes by the worker."""
        return self.program_suspended or not self.program

    def _drive(self) -> None:
        """Let time pass for as long as no program drives."""
        if not self.lock.acquire(MAX_LAG_S):
            return
        try:
            self._restart_clock()
            while not self._closed and self._drives():
                self._carry_out_orders()
                if (action := self._next_action()) is not None:
                    self._perform(action)
                elif self._paused or self._trouble:
                    self._rest()
                else:
                    self._run_slice()
            self._restart_clock()
        finally:
            self.lock.release()

    def _observe_program(self) -> None:
        """Carry out orders between the calls of a program, and publish what it has changed."""
        self._wait(SLICE_S)
        if self.stage.now != self._view_now:
            self._changed_at = perf_counter()
        is_recent = perf_counter() - self._changed_at < AFTERGLOW_S
        if (self._orders or is_recent) and self.lock.acquire(SLICE_S):
            try:
                self._carry_out_orders()
                self._history.remember(self.stage)
                self._trouble = ""  # checked again: the program may have ended it
                self._publish()
            finally:
                self.lock.release()

    def _run_slice(self) -> None:
        """Let a slice pass without an action. It ends early for an action, and where time has jumped."""
        self._jumped = False
        try:
            self.stage.run(max(self._clock.slice_s, self.stage.state.dt * 1e-9))
        except SimulationError as error:
            self._trouble = str(error)
            self._publish()
        except ActionStopped:
            pass

    def _rest(self) -> None:
        self._publish()
        self._wait(IDLE_INTERVAL_S)

    def _wait(self, seconds: float) -> None:
        """Wait for orders, actions or other changes, `seconds` of real time at most."""
        with self._work:
            self._work.wait_for(lambda: self._has_work, seconds)
            self._has_work = False

    def _carry_out_orders(self) -> None:
        carried_out = False
        while True:
            with self._work:
                if not self._orders:
                    break
                order, future = self._orders.popleft()
            carried_out = True
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(order(self.stage))
                except BaseException as error:
                    future.set_exception(error)
        if carried_out:
            self._publish()

    def _next_action(self) -> Action | None:
        with self._work:
            self._acting = self._actions.popleft() if self._actions else None
            return self._acting

    def _perform(self, action: Action) -> None:
        self._restart_clock()
        self._publish()
        try:
            if action.future.set_running_or_notify_cancel():
                action.future.set_result(action.run(self.stage))
        except BaseException as error:
            action.future.set_exception(error)
        finally:
            self._acting = None
            self._publish()

    def _refuse_waiting(self) -> None:
        with self._work:
            futures = [*(future for _, future in self._orders), *(action.future for action in self._actions)]
        for future in futures:
            if future.set_running_or_notify_cancel():  # else nobody waits for it any more
                future.set_exception(StageError(SESSION_OVER))

    def _publish(self) -> None:
        """Renew the `view`, and call the observers. A carriage that has left its travel is trouble, however it came there."""
        stage, acting = self.stage, self._acting
        if not self._trouble:
            self._trouble = describe_escape(stage)
        if self._trouble and acting is not None:
            acting.stopped = True
        self._clock.measure(stage.now)
        self._view_now = stage.now
        self.view = StageView(
            self.view.number + 1, stage.time, self._clock.achieved_speed, acting.name if acting else "", self._trouble,
            np.array(stage.data.qpos),
        )  # fmt: skip
        for observer in self._observers:
            observer(stage)
        with self.changed:
            self.changed.notify_all()

    # --- time ---

    def _restart_clock(self) -> None:
        self._clock.restart(self.stage.now)

    def run_unpaced(self, run: Callable[..., T], *args: Any) -> T:
        """Let an order pass time as fast as it goes, without orders in between.

        Args:
            run: Function that lets time pass.
            *args: Its arguments.

        Returns:
            Its result.
        """
        self._unpaced = True
        try:
            return run(*args)
        finally:
            self._unpaced = False
            self._restart_clock()

    def _pace(self, until: int) -> int:
        """Wait until simulated time may go on towards `until`, ns, and return how far it may go now; see `Loop.pace`."""
        if until - self._words.item(0) < MAX_BUS_CYCLE_NS or self._unpaced:
            return until
        if 0 <= until - self._polled_at < min(MAX_UNPACED_NS, self._clock.slice_s * 1e9):
            return until
        with self.lock:
            if threading.get_ident() == self._identifier:
                goal = self._pace_worker(until)
            else:
                goal = self._pace_program(until)
                if self._ending:
                    raise ActionStopped("the program ends.")
        self._polled_at = goal
        self._clock.start_slice(self.stage.now)
        return goal

    def _pace_worker(self, until: int) -> int:
        stage, clock = self.stage, self._clock
        self._publish()
        goal = stage.now
        while True:
            if self._closed or self._is_over():
                raise ActionStopped("stopped.")
            self._carry_out_orders()
            if self._closed or self._is_over():
                raise ActionStopped("stopped.")
            if self._paused:
                self._rest()
                continue
            goal = clock.plan_slice(stage.now, until, stage.state.dt)
            if (left := clock.seconds_until(goal, stage.now)) <= 0:
                break
            self._wait(left)
        self._history.remember(stage)
        return max(goal, stage.now)

    def _is_over(self) -> bool:
        """Return whether the function that lets time pass in the worker is to end where it is."""
        if self._acting is not None:
            return self._acting.stopped
        return self._jumped or bool(self._actions or self._trouble) or not self._drives()

    def _pace_program(self, until: int, seconds: float = SLICE_S) -> int:
        """Wait as `_pace`, in a thread of the program; threads that wait for the stage have it meanwhile."""
        stage, clock = self.stage, self._clock
        self.lock.yield_to_waiting()
        while self.program and not (self._closed or self._ending):
            now = stage.now
            if now >= until:  # another thread has let so much time pass
                break
            if self._paused:
                self.lock.wait()
                continue
            goal = clock.plan_slice(now, until, stage.state.dt if seconds else 0, seconds)
            left = clock.seconds_until(goal, now)
            if left <= 0:
                return goal
            self.lock.wait(left)
        return until
