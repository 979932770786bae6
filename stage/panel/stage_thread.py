"""`StageThread`: the worker thread that owns the stage of a session. This module builds no page.

The worker lets time pass in slices of SLICE_S real seconds, and carries out orders of other threads between two slices:

    thread.do(lambda stage: stage.axes["x"].chip.read(0))                     an order, which takes no time of its own
    thread.act("home x", lambda stage: firmware.home(stage.axes["x"]))        an action: an order that lets time pass

While an action lets time pass, the worker carries out orders in its waits. Cutting time into slices changes no bit of a run.

Each user of the stage takes `lock` (stage.panel.stage_lock, stage.chips.exclusive_access). There are two modes:

- The worker drives: it lets time pass, the lock is reserved for it, and other threads wait or are refused.
- A program drives from threads of its own: only its calls let time pass. Each call holds the lock from its first bus cycle to its
  last, and releases it while time passes (`_pace_in_program`); meanwhile the worker carries out orders and calls the observers.

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
from stage.panel.real_time_clock import MAX_LAG_S, PACING_INTERVAL_S, RealTimeClock
from stage.panel.snapshot_history import SnapshotHistory
from stage.panel.stage_lock import FairStageLock
from stage.sim.axis import Axis
from stage.sim.stage import Stage
from stage.units import POSITION_UNITS

T = TypeVar("T")
Order = Callable[[Stage], Any]

MAX_BUS_CYCLE_NS = 50_000  # a shorter time is a bus cycle: no order comes between the bytes of a number
MAX_UNPACED_NS = (
    1_000_000  # waits that are shorter together are not paced, and carry out no orders; as those shorter than a slice
)
OBSERVER_DELAY_S = (
    0.1  # real seconds for which observers are called after a program's last change: slow ones see its end
)
IDLE_INTERVAL_S = 0.5  # real seconds between two views of a worker that rests
MAX_PENETRATION = 0.1  # part of the travel: MuJoCo's end stops are soft, and a hard blow goes in by 3 % of the travel
SESSION_OVER = "this session is over."
RESERVED_STAGE_MESSAGE = "this stage lives in a session: give it orders, session.do(...)."


def has_end_limits(axis: Axis) -> bool:
    """Return whether an axis has end limits, and thus end stops; a rotary table that turns endlessly has none."""
    return any(switch.pin.startswith("el") for switch in axis.plant.switches)


def describe_escape(stage: Stage) -> str:
    """Return a sentence about a carriage that has gone through its end stop, with its position; "" if there is none."""
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
    """Error of an action that a user has stopped, or whose program or session has ended."""


@dataclass(frozen=True)
class StageView:
    """Values of the stage after the stage thread has let a short time pass.

    Attributes:
        number: Number of views so far.
        time: Simulated time, s.
        achieved_speed: Simulated seconds in a real second, measured recently.
        action: Name of the action under way, or "".
        trouble: Reason for which time has stopped although nobody has paused it, or "".
        qpos: Positions of the joints, as in `MjData.qpos`.
    """

    number: int
    time: float
    achieved_speed: float
    action: str
    trouble: str
    qpos: np.ndarray


@dataclass
class SessionAction:
    """Function that lets time pass on the stage, waiting for the worker or under way; `stopped`: it is to end."""

    name: str
    run: Order
    future: Future
    stopped: bool = False


class StageThread:
    """Worker thread that owns a stage from now until `close`. Any thread may call the methods.

    Args:
        stage: A stage that has no session.
        speed: Simulated seconds in a real second; FREE: as fast as possible.
        paused: Whether time stands still at first.
        program: Name of the program that drives the stage, for people; "": the worker drives.

    Attributes:
        stage: The stage.
        lock: Lock that each user of the stage takes.
        changed: Condition that is notified after each slice and each order.
        view: Values of the stage after the last slice.
        program, program_suspended: See `Session`.
    """

    def __init__(self, stage: Stage, *, speed: float = 1.0, paused: bool = False, program: str = ""):
        if stage.loop.lock is not None:
            raise StageError("this stage has a session already: close that one first.")
        self.stage, self.program, self.program_suspended = stage, program, False
        self.lock, self.changed = FairStageLock(), threading.Condition()
        self._clock, self._history = RealTimeClock(speed, stage.now), SnapshotHistory()
        self._paused, self._trouble = paused, ""
        self._closed = self._ending = self._unpaced = self._jumped = False
        self._work = threading.Condition()  # its lock is re-entrant: signal handlers may interrupt a thread that has it
        self._has_work = False
        self._orders: deque[tuple[Order, Future]] = deque()
        self._actions: deque[SessionAction] = deque()
        self._acting: SessionAction | None = None
        self._last_action: Future | None = None
        self._observers: tuple[Order, ...] = ()
        self.view = StageView(0, stage.time, speed, "", "", np.array(stage.data.qpos))
        self._view_now, self._changed_at, self._polled_at = -1, 0.0, stage.now
        self._words = stage.state.words
        self._thread = threading.Thread(target=self._run_worker, name="pulsestage session", daemon=True)
        self._started = threading.Event()
        self._thread.start()
        self._started.wait()

    # --- orders, from any thread ---

    def do(self, order: Callable[[Stage], T], timeout: float | None = None) -> T:
        """Have the worker call `order(stage)` between two slices, and wait for the result.

        An order is short: a few bus cycles or values. A thread that holds the stage's lock calls it itself, at once.

        Args:
            order: Function of the stage.
            timeout: Longest wait, real seconds; None: no limit.

        Returns:
            The result of `order`.

        Raises:
            StageError: The session is over; or an error of `order`.
            TimeoutError: The order was not carried out in time.
        """
        return order(self.stage) if self.lock.is_acquired() else self.post(order).result(timeout)

    def post(self, order: Callable[[Stage], T]) -> Future[T]:
        """Have the worker call `order(stage)` as `do` does, without waiting; return the future of its result."""
        future: Future[T] = Future()
        with self._work:
            self._check_open()
            self._orders.append((order, future))
            self._wake_worker()
        return future

    def act(self, name: str, run: Callable[[Stage], T]) -> Future[T]:
        """Have the worker call `run(stage)`, which lets time pass. Actions run one after the other.

        Args:
            name: Name of the action, for people.
            run: Function of the stage, for example a procedure of stage.firmware.

        Returns:
            Future of the result of `run`.

        Raises:
            StageError: The session is over.
        """
        action = SessionAction(name, run, Future())
        with self._work:
            self._check_open()
            self._last_action = action.future
            self._actions.append(action)
            self._wake_worker()
        return action.future

    def stop_actions(self) -> bool:
        """End the action under way and all that wait: they raise ActionStopped. The chips continue what they do.

        Returns:
            Whether an action was under way.
        """
        with self._work:
            acting, waiting = self._acting, list(self._actions)
            self._actions.clear()
            if acting is not None:
                acting.stopped = True
            self._wake_worker()
        for action in waiting:
            if action.future.set_running_or_notify_cancel():
                action.future.set_exception(ActionStopped("stopped."))
        return acting is not None

    @property
    def busy(self) -> bool:
        """True if an action is under way or waits for its turn."""
        last = self._last_action
        return last is not None and not last.done()

    def call_after_pacing_intervals(self, observer: Order) -> Callable[[], None]:
        """Have the worker call `observer(stage)` after each slice; return a function that ends these calls."""
        with self._work:
            self._observers = (*self._observers, observer)

        def end() -> None:
            with self._work:
                self._observers = tuple(o for o in self._observers if o is not observer)

        return end

    def close(self) -> None:
        """Stop the worker, and leave the stage in its present state to the caller. Waiting orders and actions get a StageError."""
        with self._work:
            self._closed = True
        self._notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _check_open(self) -> None:
        if self._closed:
            raise StageError(SESSION_OVER)

    def _notify_all(self) -> None:
        """Make all waiting threads check their conditions again."""
        self._wake_worker()
        self.lock.notify_all()

    def _wake_worker(self) -> None:
        """Wake the worker."""
        with self._work:
            self._has_work = True
            self._work.notify_all()

    # --- the worker ---

    def _run_worker(self) -> None:
        """Drive the stage, or observe its program, until `close`. The worker thread runs this method."""
        loop = self.stage.loop
        self._identifier = threading.get_ident()
        self._share_lock(self.lock)
        loop.pace = self._pace
        self._update_reservation()
        self._started.set()
        try:
            while not self._closed:
                (self._drive_stage if self._is_driving() else self._observe_program)()
        finally:
            loop.pace = None
            self._share_lock(None)
            self.lock.reserve(0)
            self._refuse_waiting_orders()

    def _share_lock(self, lock: FairStageLock | None) -> None:
        """Let the stage and its chips use a lock, or none (None)."""
        self.stage.loop.lock = lock
        for chip in self.stage.chips:
            chip.set_lock(lock)

    def _update_reservation(self) -> None:
        """Reserve the lock for the worker if it drives, and refuse all other threads if there is also no program."""
        drives = self._is_driving() and not self._closed
        self.lock.reserve(
            self._identifier if drives else 0, "" if self.program or not drives else RESERVED_STAGE_MESSAGE
        )
        self._notify_all()

    def _is_driving(self) -> bool:
        """Return whether the worker lets time pass, and not a program."""
        return self.program_suspended or not self.program

    def _drive_stage(self) -> None:
        """Let time pass and carry out orders and actions until a program drives."""
        if not self.lock.acquire(MAX_LAG_S):
            return
        try:
            self._restart_clock()
            while not self._closed and self._is_driving():
                self._carry_out_orders()
                if (action := self._take_next_action()) is not None:
                    self._perform_action(action)
                elif self._paused or self._trouble:
                    self._wait_paused()
                else:
                    self._run_pacing_interval()
            self._restart_clock()
        finally:
            self.lock.release()

    def _observe_program(self) -> None:
        """Carry out orders between the calls of a program, and publish the changes that the program has made."""
        self._wait_for_work(PACING_INTERVAL_S)
        if self.stage.now != self._view_now:
            self._changed_at = perf_counter()
        is_recent = perf_counter() - self._changed_at < OBSERVER_DELAY_S
        if (self._orders or is_recent) and self.lock.acquire(PACING_INTERVAL_S):
            try:
                self._carry_out_orders()
                self._history.take_snapshot_if_due(self.stage)
                self._trouble = ""  # checked again: the program may have ended it
                self._publish_view()
            finally:
                self.lock.release()

    def _run_pacing_interval(self) -> None:
        """Let a slice of time pass without an action. The slice ends early when an action comes, and when the state is replaced."""
        self._jumped = False
        try:
            self.stage.run(max(self._clock.pacing_interval_s, self.stage.state.dt * 1e-9))
        except SimulationError as error:
            self._trouble = str(error)
            self._publish_view()
        except ActionStopped:
            pass

    def _wait_paused(self) -> None:
        self._publish_view()
        self._wait_for_work(IDLE_INTERVAL_S)

    def _wait_for_work(self, seconds: float) -> None:
        """Wait for orders, actions or other changes, `seconds` real seconds at most."""
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
            self._publish_view()

    def _take_next_action(self) -> SessionAction | None:
        """Take the next waiting action and make it the one under way; None if none waits."""
        with self._work:
            self._acting = self._actions.popleft() if self._actions else None
            return self._acting

    def _perform_action(self, action: SessionAction) -> None:
        """Run an action, and set the result of its future."""
        self._restart_clock()
        self._publish_view()
        try:
            if action.future.set_running_or_notify_cancel():
                action.future.set_result(action.run(self.stage))
        except BaseException as error:
            action.future.set_exception(error)
        finally:
            self._acting = None
            self._publish_view()

    def _refuse_waiting_orders(self) -> None:
        with self._work:
            futures = [*(future for _, future in self._orders), *(action.future for action in self._actions)]
        for future in futures:
            if future.set_running_or_notify_cancel():  # else nobody waits for it any more
                future.set_exception(StageError(SESSION_OVER))

    def _publish_view(self) -> None:
        """Update `view`, and call the observers. A carriage beyond its end stop counts as trouble, whatever moved it there."""
        stage, acting = self.stage, self._acting
        if not self._trouble:
            self._trouble = describe_escape(stage)
        if self._trouble and acting is not None:
            acting.stopped = True
        self._clock.update_achieved_speed(stage.now)
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
        """Call a function that lets time pass as fast as possible, without orders meanwhile. Only orders may call this method.

        Args:
            run: Function that lets time pass.
            *args: Arguments of `run`.

        Returns:
            The result of `run`.
        """
        self._unpaced = True
        try:
            return run(*args)
        finally:
            self._unpaced = False
            self._restart_clock()

    def _pace(self, until: int) -> int:
        """Wait until simulated time may pass towards `until`, ns, and return how far it may go now, ns. See `StageLoop.pace`."""
        if until - self._words.item(0) < MAX_BUS_CYCLE_NS or self._unpaced:
            return until
        if 0 <= until - self._polled_at < min(MAX_UNPACED_NS, self._clock.pacing_interval_s * 1e9):
            return until
        with self.lock:
            if threading.get_ident() == self._identifier:
                goal = self._pace_in_worker(until)
            else:
                goal = self._pace_in_program(until)
                if self._ending:
                    raise ActionStopped("the program ends.")
        self._polled_at = goal
        self._clock.start_pacing_interval(self.stage.now)
        return goal

    def _pace_in_worker(self, until: int) -> int:
        """Wait as `_pace` does, in the worker, and carry out orders meanwhile. Raises ActionStopped when the action has to end."""
        stage, clock = self.stage, self._clock
        self._publish_view()
        goal = stage.now
        while True:
            if self._closed or self._is_over():
                raise ActionStopped("stopped.")
            self._carry_out_orders()
            if self._closed or self._is_over():
                raise ActionStopped("stopped.")
            if self._paused:
                self._wait_paused()
                continue
            goal = clock.plan_pacing_interval(stage.now, until, stage.state.dt)
            if (left := clock.compute_seconds_until(goal, stage.now)) <= 0:
                break
            self._wait_for_work(left)
        self._history.take_snapshot_if_due(stage)
        return max(goal, stage.now)

    def _is_over(self) -> bool:
        """Return whether the function that lets time pass in the worker has to end now."""
        if self._acting is not None:
            return self._acting.stopped
        return self._jumped or bool(self._actions or self._trouble) or not self._is_driving()

    def _pace_in_program(self, until: int, seconds: float = PACING_INTERVAL_S) -> int:
        """Wait as `_pace` does, in a thread of the program; threads that wait for the stage hold the lock meanwhile."""
        stage, clock = self.stage, self._clock
        self.lock.yield_to_waiting()
        while self.program and not (self._closed or self._ending):
            now = stage.now
            if now >= until:  # another thread has let so much time pass
                break
            if self._paused:
                self.lock.wait()
                continue
            goal = clock.plan_pacing_interval(now, until, stage.state.dt if seconds else 0, seconds)
            left = clock.compute_seconds_until(goal, now)
            if left <= 0:
                return goal
            self.lock.wait(left)
        return until
