"""`Queues`: what waits for a stage's thread: orders, which take no time of the stage's, and actions, which let it pass. No page.

queues.post(order), queues.act("move", order)     from any thread; a Future each
queues.carry_out(stage), queues.perform(...)      in the stage's thread
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stage.errors import StageError

if TYPE_CHECKING:
    from stage.sim.stage import Stage


class Abandoned(StageError):
    """Somebody has stopped this action, or the session is over."""


@dataclass
class Action:
    """name: for people. abandoned: it is to end where it is."""

    name: str
    order: Callable[[Stage], Any]
    future: Future
    abandoned: bool = False


class Queues:
    """Orders and actions, each in their order.

    Attributes: acting: the action under way, or None.
    """

    def __init__(self) -> None:
        self._orders: deque[tuple[Callable[[Stage], Any], Future]] = deque()
        self._actions: deque[Action] = deque()
        self._last: Future | None = None  # of the action that came last
        self._over = False
        self.acting: Action | None = None

    def post(self, order: Callable[[Stage], Any]) -> Future:
        """Raises StageError after `end`."""
        self._check()
        future: Future = Future()
        self._orders.append((order, future))
        return future

    def act(self, name: str, order: Callable[[Stage], Any]) -> Future:
        """Raises StageError after `end`."""
        self._check()
        action = Action(name, order, Future())
        self._last = action.future
        self._actions.append(action)
        return action.future

    def abandon(self) -> bool:
        """The action under way is to end; whether there was one."""
        action = self.acting
        if action is not None:
            action.abandoned = True
        return action is not None

    @property
    def busy(self) -> bool:
        """An action is under way, or waits to be."""
        return self._last is not None and not self._last.done()

    @property
    def orders(self) -> bool:
        """Some order waits."""
        return bool(self._orders)

    @property
    def actions(self) -> bool:
        """Some action waits."""
        return bool(self._actions)

    # --- in the stage's thread ---

    def carry_out(self, stage: Stage) -> bool:
        """The orders that have come; whether there were some."""
        some = False
        while self._orders:
            order, future = self._orders.popleft()
            some = True
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(order(stage))
                except BaseException as error:
                    future.set_exception(error)
        return some

    def perform(self, stage: Stage, look: Callable[[], None]) -> None:
        """The next action, from its beginning to its end; `look` is called at both."""
        action = self.acting = self._actions.popleft()
        look()
        try:
            if not action.future.set_running_or_notify_cancel():
                return
            answer = action.order(stage)
        except BaseException as error:
            action.future.set_exception(error)
        else:
            action.future.set_result(answer)
        finally:
            self.acting = None
            look()

    def refuse(self) -> None:
        """Nothing more is taken."""
        self._over = True

    def end(self) -> None:
        """What waits still is told that nobody will do it."""
        self._over = True
        over = StageError("this session is over.")
        for future in (*(f for _, f in self._orders), *(a.future for a in self._actions)):
            if future.set_running_or_notify_cancel():  # else nobody waits for it any more
                future.set_exception(over)

    def _check(self) -> None:
        if self._over:
            raise StageError("this session is over.")
