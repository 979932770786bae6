"""`Session`: a stage in real time, and orders for it while it runs. No page: the panel's page, and whoever else wants a stage that
lives beside him, talk to it.

    with Session(Stage("xyz")) as session:
        session.do(lambda stage: stage.axes["x"].chip.write(0, 0x11))      between two slices of time; returns what it returns
        session.act("home x", lambda stage: firmware.home(stage.axes["x"]))  for as long as it takes; orders go on meanwhile
        session.paused = True
        session.back(2.0)                                                    two seconds ago, by a snapshot
        session.view                                                         what was there after the last slice

One thread of the session's own runs the stage and carries out orders, in their order. Time is cut into slices of SLICE seconds of
real time at most; the stage's promise that cutting time changes nothing makes a session's run that of the same program without one.

A program of somebody's own can have the stage, Session(stage, program="mine"): it drives from its own thread as it would without a
session, in real time, and no time passes but by it, so its run is bit for bit that without a session. Orders are carried out where
it is not at the stage, see turns.py. `take_over()` makes it wait where it next comes to the stage, and the session's thread lets
time pass as if there were no program; `give_back()` lets it go on.
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

from stage.errors import ArgumentError, SimulationError, StageError
from stage.panel.past import Past
from stage.panel.turns import Turns
from stage.sim.stage import Snapshot, Stage

T = TypeVar("T")
SLICE = 0.02  # s of real time, between looks at orders
BEHIND = 0.2  # s of real time by which a session may be late before it gives up catching up
RECOVERED = 0.5  # s of simulated time before a divergence all is well
LAST_LOOK = (
    0.1  # s of real time for which one looks on after a program has done something: those who look seldom see its end
)
SLOWEST, FASTEST = 0.001, 1000.0
SHORTEST = 1_000_000  # ns: what is shorter, a bus cycle, does not wait for real time
FREE = float("inf")


class Abandoned(StageError):
    """Somebody has stopped this action, or the session is over."""


@dataclass(frozen=True)
class View:
    """What was there after the last slice. time: simulated s; pace: simulated seconds a real second of late, `speed` where it keeps
    up; doing: the action under way, or ""; trouble: why time stands still though nobody paused, or ""."""

    number: int
    time: float
    pace: float
    doing: str
    trouble: str
    qpos: np.ndarray


@dataclass
class _Action:
    name: str
    order: Callable[[Stage], Any]
    future: Future
    abandoned: bool = False


class Session:
    """A stage that lives in real time, in a thread of its own.

    Args:
        stage: nobody else may run it while the session lasts.
        speed: simulated seconds a real second; `FREE`: as fast as it goes.
        program: who has the stage, for people; "": the session alone.

    Attributes:
        changed: a threading.Condition; notified after each slice and each order.
        taken: the program waits, or will where it next comes to the stage: the session has it.
    """

    def __init__(self, stage: Stage, *, speed: float = 1.0, paused: bool = False, program: str = ""):
        self.stage, self.program, self.taken = stage, program, False
        self._turns = Turns()
        self._called = threading.Event()  # the session's thread, while a program has the stage
        self.changed = threading.Condition()
        self._orders: deque[tuple[Callable[[Stage], Any], Future]] = deque()
        self._actions: deque[_Action] = deque()
        self._acting: _Action | None = None
        self._last: Future | None = None  # of the action that came last
        self._wake = threading.Event()
        self._paused, self._closed, self._speed = paused, False, 1.0
        self._hasty = self._jumped = False
        self._past = Past()
        self._real, self._simulated = perf_counter(), stage.now
        self._pace, self._measured = speed, (perf_counter(), stage.now)
        self._number, self._published, self._changed_at = 0, -1, 0.0
        self._trouble = ""
        self._looks: list[Callable[[Stage], None]] = []
        self.speed = speed
        self.view = self._seen()
        self._thread = threading.Thread(target=self._live, name="pulsestage session", daemon=True)
        if stage.loop.pace is not None:
            raise StageError("this stage has a session already: close that one first.")
        stage.loop.pace = self._until
        self._thread.start()

    # --- for everybody, from any thread ---

    def do(self, order: Callable[[Stage], T], timeout: float | None = None) -> T:
        """Have the stage's thread call `order(stage)` between two slices; returns or raises what it does. Short things: bus cycles,
        a look. Within an order it is called at once. Raises StageError when the session is over."""
        if threading.current_thread() is self._thread:
            return order(self.stage)
        future = self.post(order)
        with self._turns.asking():
            return future.result(timeout)

    def post(self, order: Callable[[Stage], T]) -> Future[T]:
        """As `do`, without waiting."""
        future: Future[T] = Future()
        if self._closed:
            raise StageError("this session is over.")
        self._orders.append((order, future))
        self._ring()
        return future

    def act(self, name: str, order: Callable[[Stage], T]) -> Future[T]:
        """Have the stage's thread call `order(stage)`, which lets time pass itself: a procedure of stage.firmware, for example.
        Orders of `do` are carried out meanwhile; actions come one after the other. Raises StageError when the session is over."""
        if self._closed:
            raise StageError("this session is over.")
        action: _Action = _Action(name, order, Future())
        self._last = action.future
        self._actions.append(action)
        self._wake.set()
        return action.future

    def abandon(self) -> bool:
        """Stop the action under way where it is: its next wait raises Abandoned. The chips go on with what they do. Whether there
        was one."""
        action = self._acting
        if action is None:
            return False
        action.abandoned = True
        self._wake.set()
        return True

    @property
    def busy(self) -> bool:
        """An action is under way, or waits to be."""
        return self._last is not None and not self._last.done()

    @property
    def speed(self) -> float:
        """Simulated seconds a real second, SLOWEST to FASTEST, or FREE."""
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        if value != FREE and not SLOWEST <= value <= FASTEST:
            raise ArgumentError(
                f"speed={value!r}: {SLOWEST:g} to {FASTEST:g} simulated seconds a second, or FREE, as fast as it goes."
            )
        self._speed = float(value)
        self._restart_clock()
        self._ring()

    @property
    def paused(self) -> bool:
        """Time stands still. Bus cycles take their time all the same."""
        return self._paused

    @paused.setter
    def paused(self, value: bool) -> None:
        self._paused = bool(value)
        if not value:
            self._trouble = ""
            self._restart_clock()
        self._ring()

    def single_step(self, n: int = 1) -> None:
        """Pause, and let n physics steps pass."""
        self._paused = True
        self.do(lambda stage: self._at_once(stage.step, n))

    def back(self, seconds: float) -> float:
        """Go back by so many simulated seconds, as far as the session remembers, to the snapshot before; returns the time (s) that
        it is then. An action under way is abandoned. Raises StageError while a recording goes on."""
        if not seconds >= 0:
            raise ArgumentError(f"back({seconds!r}): seconds, 0 or more.")
        self.abandon()
        return self.do(lambda stage: self._back(stage, stage.now - round(seconds * 1e9)))

    def recover(self) -> float:
        """After a divergence: back to before it, where time stands still until somebody has mended the cause. The time, s."""
        self.paused = True
        return self.back(RECOVERED)

    def reset(self) -> None:
        """Power-up. Raises StageError while a recording goes on."""
        self.abandon()
        self.do(lambda stage: self._go_to(stage, stage.reset))

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a snapshot. Raises as `Stage.restore`."""
        self.abandon()
        self.do(lambda stage: self._go_to(stage, lambda: stage.restore(snapshot)))

    @property
    def remembered(self) -> float:
        """Simulated seconds that one can go back now."""
        return self._past.seconds(self.stage.now)

    def on_slice(self, look: Callable[[Stage], None]) -> Callable[[], None]:
        """Have `look(stage)` called by the stage's thread after each slice; returns what ends it."""
        self._looks.append(look)

        def end() -> None:
            if look in self._looks:  # it may have ended already
                self._looks.remove(look)

        return end

    # --- a program beside it ---

    def take_over(self) -> None:
        """The session has the stage: the program waits where it next comes to it."""
        self.taken = bool(self.program)
        self._ring()

    def give_back(self) -> None:
        """The program has the stage again; an action under way is abandoned."""
        self.abandon()
        self.taken = False
        self._ring()

    def dismiss(self) -> None:
        """The program has ended: the session has the stage alone."""
        self.program, self.taken = "", False
        self._turns.forget()
        self._ring()

    @property
    def waits(self) -> bool:
        """The program has come to the stage and waits for it to be given back."""
        return self.taken and self._turns.waiting

    @property
    def piece(self) -> float:
        """Simulated seconds between two `catch_up` of a program."""
        return SLICE * (1.0 if self._speed == FREE else self._speed)

    def catch_up(self) -> None:
        """For a program that lets time pass otherwise than by the stage, as a board does: waits until real time has come as far,
        and for as long as somebody has paused or taken over."""
        self._admit(self.stage.now + SHORTEST, ahead=0)

    def close(self) -> None:
        """End: the stage is the caller's again, where it is."""
        self._closed = True
        self._ring()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # --- in the stage's thread ---

    def _live(self) -> None:
        try:
            while not self._closed:
                if self.program and not self.taken:
                    self._beside()
                elif self._turns.claim(BEHIND, self._is_over):
                    self._live_on()
        finally:
            self.stage.loop.pace = None
            self._turns.release()
            over = StageError("this session is over.")
            for _, future in self._orders:
                future.set_exception(over)
            for action in self._actions:
                action.future.set_exception(over)

    def _is_over(self) -> bool:
        return self._closed

    def _live_on(self) -> None:
        """For as long as the stage is the session's."""
        self._restart_clock()
        while not self._closed and (self.taken or not self.program):
            self._carry_out()
            if self._actions:
                self._perform(self._actions.popleft())
            elif self._paused or self._trouble:
                self._rest()
            else:
                self._run()
        if self.program:
            self._restart_clock()
            self._turns.release()

    def _beside(self) -> None:
        """A program has the stage: orders are carried out between what it does, and what it has done is seen."""
        self._called.wait(SLICE)
        self._called.clear()
        changed = perf_counter() if self.stage.now != self._published else self._changed_at
        self._changed_at, news = changed, perf_counter() - changed < LAST_LOOK
        if (self._orders or news) and self._turns.claim(SLICE, self._is_over):
            try:
                self._carry_out()
                self._past.remember(self.stage)
                self._publish()
            finally:
                self._turns.release()

    def _run(self) -> None:
        """A slice without anybody's action. It ends early for an action, and where time has jumped: its end lies elsewhere then."""
        self._jumped = False
        fast = 1.0 if self._speed == FREE else self._speed
        try:
            self.stage.run(SLICE * fast)
        except SimulationError as error:
            self._trouble = str(error)
            self._publish()
        except Abandoned:
            pass

    def _perform(self, action: _Action) -> None:
        self._acting = action
        self._restart_clock()
        self._publish()
        try:
            if not action.future.set_running_or_notify_cancel():
                return
            answer = action.order(self.stage)
        except BaseException as error:
            action.future.set_exception(error)
        else:
            action.future.set_result(answer)
        finally:
            self._acting = None
            self._publish()

    def _until(self, until: int) -> int:
        """The stage's time is to go on to `until`, ns: how far it may go now, when it is due. See `Loop.pace`."""
        stage = self.stage
        if threading.current_thread() is not self._thread:
            until = self._admit(until) if self.program else until
            if not (self.program or self._closed):
                raise StageError("this stage lives in a session: give it orders, session.do(...).")
            return until
        now = stage.now
        if until - now < SHORTEST or self._hasty:
            return until
        self._publish()
        while True:
            self._carry_out()
            if self._closed or self._over():
                raise Abandoned("stopped.")
            if not self._paused:
                break
            self._rest()
        self._past.remember(stage)
        return self._due(until)

    def _admit(self, until: int, ahead: float = SLICE) -> int:
        """As `_until`, for a program, in its thread: nothing but waiting happens here. ahead: real seconds that it may go at a
        time."""
        self._turns.admit()
        now = self.stage.now
        if until - now < SHORTEST:
            return until
        while self.program and not self._closed:
            if self._paused:
                self._turns.rest(0.5)
            else:
                now, speed = self.stage.now, self._speed
                if speed == FREE:
                    return min(until, now + round(SLICE * 1e9))
                goal = min(until, now + max(round(ahead * speed * 1e9), self.stage.state.dt if ahead else 0))
                early = self._due_at(goal) - perf_counter()
                if early < -BEHIND:
                    self._restart_clock()
                if early <= 0:
                    return goal
                self._turns.rest(min(early, 0.5))
            now = self.stage.now
            if now >= until:  # somebody else has let so much time pass
                return until
        return until

    def _due(self, until: int) -> int:
        """How far the stage may go towards `until`, when that is due; orders are carried out until then."""
        now, speed = self.stage.now, self._speed
        if speed == FREE:
            return min(until, now + round(SLICE * 1e9))
        goal = min(until, now + max(round(SLICE * speed * 1e9), self.stage.state.dt))
        late = perf_counter() - self._due_at(goal)
        if late > BEHIND:
            self._restart_clock()
        while (early := self._due_at(goal) - perf_counter()) > 0:
            self._wake.wait(early)
            self._wake.clear()
            self._carry_out()
            if self._paused or self._closed or speed != self._speed or self._over():
                return self.stage.now  # nothing passes; asked again at once
        return max(goal, self.stage.now)

    def _over(self) -> bool:
        """Whether what lets time pass is to end where it is."""
        if self._acting is not None:
            return self._acting.abandoned
        return self._jumped or bool(self._actions) or bool(self.program and not self.taken)

    def _due_at(self, goal: int) -> float:
        return self._real + (goal - self._simulated) * 1e-9 / self._speed

    def _restart_clock(self) -> None:
        self._real, self._simulated = perf_counter(), self.stage.now
        self._measured = (self._real, self._simulated)

    def _rest(self) -> None:
        self._publish()
        self._wake.wait(0.5)
        self._wake.clear()

    def _carry_out(self) -> None:
        """The orders that have come."""
        some = False
        while self._orders:
            order, future = self._orders.popleft()
            some = True
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(order(self.stage))
                except BaseException as error:
                    future.set_exception(error)
        if some:
            self._publish()

    def _at_once(self, run: Callable[..., Any], *given: Any) -> None:
        """Let time pass as fast as it goes, without orders between."""
        self._hasty = True
        try:
            run(*given)
        finally:
            self._hasty = False
            self._restart_clock()

    def _back(self, stage: Stage, goal: int) -> float:
        snapshot = self._past.before(goal)
        if snapshot is not None:
            self._go_to(stage, lambda: stage.restore(snapshot))
        return stage.time

    def _go_to(self, stage: Stage, change: Callable[[], None]) -> None:
        change()
        self._jumped, self._trouble = True, ""
        self._past.forget_after(stage.now)
        self._restart_clock()

    def _ring(self) -> None:
        """Something has changed: whoever waits looks again."""
        self._wake.set()
        self._called.set()
        self._turns.ring()

    def _publish(self) -> None:
        """What is there now becomes `view`."""
        real, simulated = perf_counter(), self.stage.now
        passed = real - self._measured[0]
        if passed > 0.25:
            self._pace = (simulated - self._measured[1]) * 1e-9 / passed
            self._measured = (real, simulated)
        self._number += 1
        self._published = simulated
        self.view = self._seen()
        for look in tuple(self._looks):
            look(self.stage)
        with self.changed:
            self.changed.notify_all()

    def _seen(self) -> View:
        doing = self._acting.name if self._acting else ""
        return View(self._number, self.stage.time, self._pace, doing, self._trouble, np.array(self.stage.data.qpos))
