"""`Session`: a stage in real time, and orders for it while it runs. No page: the panel's page, and whoever else wants a stage that
lives beside him, talk to it.

    with Session(Stage("xyz")) as session:
        session.do(lambda stage: stage.axes["x"].chip.write(0, 0x11))      between two slices of time; returns what it returns
        session.act("home x", lambda stage: firmware.home(stage.axes["x"]))  for as long as it takes; orders go on meanwhile
        session.paused = True
        session.back(2.0)                                                    two seconds ago, by a snapshot
        session.view                                                         what was there after the last slice

One thread of the session's own runs the stage and carries out orders, in their order, see life.py.

A program of somebody's own can have the stage, Session(stage, program="mine"): it drives from its own thread as it would without a
session, in real time, and no time passes but by it, so its run is bit for bit that without a session. Orders are carried out where
it is not at the stage, see turns.py. `take_over()` makes it wait where it next comes to the stage, and the session's thread lets
time pass as if there were no program; `give_back()` lets it go on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from stage.errors import ArgumentError
from stage.panel.admission import SHORTEST
from stage.panel.clock import FREE
from stage.panel.life import Life
from stage.panel.queues import Abandoned
from stage.panel.view import View
from stage.sim.stage import Snapshot, Stage

T = TypeVar("T")
RECOVERED = 0.5  # s of simulated time before trouble all is well


class Session:
    """A stage that lives in real time, in a thread of its own.

    Args:
        stage: nobody else may run it while the session lasts.
        speed: simulated seconds a real second; `FREE`: as fast as it goes.
        program: who has the stage, for people; "": the session alone.

    Attributes:
        changed: a threading.Condition; notified after each slice and each order.
    """

    def __init__(self, stage: Stage, *, speed: float = 1.0, paused: bool = False, program: str = ""):
        self._life = Life(stage, speed, paused, program)
        self.stage, self.changed = stage, self._life.views.changed

    # --- for everybody, from any thread ---

    def do(self, order: Callable[[Stage], T], timeout: float | None = None) -> T:
        """Have the stage's thread call `order(stage)` between two slices; returns or raises what it does. Short things: bus cycles,
        a look. Within an order it is called at once. Raises StageError when the session is over."""
        if threading.current_thread() is self._life.thread:
            return order(self.stage)
        future = self.post(order)
        with self._life.turns.asking():
            return future.result(timeout)

    def post(self, order: Callable[[Stage], T]) -> Future[T]:
        """As `do`, without waiting."""
        future = self._life.queues.post(order)
        self._life.ring()
        return future

    def act(self, name: str, order: Callable[[Stage], T]) -> Future[T]:
        """Have the stage's thread call `order(stage)`, which lets time pass itself: a procedure of stage.firmware, for example.
        Orders of `do` are carried out meanwhile; actions come one after the other. Raises StageError when the session is over."""
        future = self._life.queues.act(name, order)
        self._life.wake.set()
        return future

    def abandon(self) -> bool:
        """Stop the action under way where it is: its next wait raises Abandoned. The chips go on with what they do. Whether there
        was one."""
        was = self._life.queues.abandon()
        self._life.wake.set()
        return was

    @property
    def busy(self) -> bool:
        """An action is under way, or waits to be."""
        return self._life.queues.busy

    @property
    def view(self) -> View:
        """What was there after the last slice."""
        return self._life.views.last

    def on_slice(self, look: Callable[[Stage], None]) -> Callable[[], None]:
        """Have `look(stage)` called by the stage's thread after each slice; returns what ends it."""
        return self._life.views.on_slice(look)

    @property
    def speed(self) -> float:
        """Simulated seconds a real second, SLOWEST to FASTEST of stage.panel.clock, or FREE. Raises ArgumentError."""
        return self._life.clock.speed

    @speed.setter
    def speed(self, value: float) -> None:
        self._life.clock.speed = value
        self._life.restart_clock()
        self._life.ring()

    @property
    def paused(self) -> bool:
        """Time stands still. Bus cycles take their time all the same."""
        return self._life.paused

    @paused.setter
    def paused(self, value: bool) -> None:
        self._life.paused = bool(value)
        if not value:
            self._life.trouble = ""
            self._life.restart_clock()
        self._life.ring()

    def single_step(self, n: int = 1) -> None:
        """Pause, and let n physics steps pass."""
        self._life.paused = True
        self.do(lambda stage: self._life.at_once(stage.step, n))

    def back(self, seconds: float) -> float:
        """Go back by so many simulated seconds, as far as the session remembers, to the snapshot before; returns the time (s) that
        it is then. An action under way is abandoned. Raises StageError while a recording goes on, and where the stage had another
        motor then."""
        if not seconds >= 0:
            raise ArgumentError(f"back({seconds!r}): seconds, 0 or more.")
        self.abandon()
        return self.do(lambda stage: self._life.back(stage.now - round(seconds * 1e9)))

    def recover(self) -> float:
        """After a divergence: back to before it, where time stands still until somebody has mended the cause. The time, s."""
        self.paused = True
        self.abandon()
        return self.do(lambda stage: self._life.back(stage.now - round(RECOVERED * 1e9), to_good=True))

    def reset(self) -> None:
        """Power-up. Raises StageError while a recording goes on."""
        self.abandon()
        self.do(lambda stage: self._life.go_to(stage.reset))

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a snapshot. Raises as `Stage.restore`."""
        self.abandon()
        self.do(lambda stage: self._life.go_to(lambda: stage.restore(snapshot)))

    @property
    def remembered(self) -> float:
        """Simulated seconds that one can go back now."""
        return self._life.past.seconds(self.stage.now)

    # --- a program beside it ---

    @property
    def program(self) -> str:
        """Who has the stage, for people; "": the session alone."""
        return self._life.program

    @property
    def taken(self) -> bool:
        """The program waits, or will where it next comes to the stage: the session has it."""
        return self._life.taken

    def take_over(self) -> None:
        """The session has the stage: the program waits where it next comes to it."""
        self._life.taken = bool(self.program)
        self._life.ring()

    def give_back(self) -> None:
        """The program has the stage again; an action under way is abandoned."""
        self.abandon()
        self._life.taken = False
        self._life.ring()

    def end_program(self) -> None:
        """The program is to end now: what it waits for, or lets pass, raises Abandoned in its thread. Also for signal handlers."""
        self._life.ending = True
        self.give_back()

    def dismiss(self) -> None:
        """The program has ended: the session has the stage alone."""
        self._life.program, self._life.taken = "", False
        self._life.turns.forget()
        self._life.ring()

    @property
    def waits(self) -> bool:
        """The program has come to the stage and waits for it to be given back."""
        return self.taken and self._life.turns.waiting

    @property
    def piece(self) -> float:
        """Simulated seconds between two `catch_up` of a program."""
        return self._life.clock.piece

    def catch_up(self) -> None:
        """For a program that lets time pass otherwise than by the stage, as a board does: waits until real time has come as far,
        and for as long as somebody has paused or taken over."""
        self._life.admission.until(self.stage.now + SHORTEST, ahead=0)

    def close(self) -> None:
        """End: the stage is the caller's again, where it is."""
        self._life.queues.refuse()
        self._life.closed = True
        self._life.ring()
        if threading.current_thread() is not self._life.thread:
            self._life.thread.join()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


__all__ = ["FREE", "Abandoned", "Session"]
