"""`Sessions`: a toolbox for each client, made when the client first needs it, closed when the client ends or falls silent.

    sessions = Sessions(ToolboxFactory(lambda: Stage("xy")), limit=64, idle_s=600.0)
    sessions.box("3f1c").call("home", {"axis": "x"})
    sessions.close("3f1c")

All stages are copies of one, so that a session costs some milliseconds and no second model file. The transports are in stdio.py and
http.py, the protocol in mcp_handlers.py.
"""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from time import monotonic

from stage.agents.budget import Budget
from stage.agents.toolbox import Toolbox
from stage.errors import StageError
from stage.sim.stage import Stage

MAX_REMEMBERED = 1000  # sessions that ended, so that a late client gets a helpful error
IDLE_S, GRACE_S, LIFE_S = 600.0, 30.0, 8 * 3600.0
MAX_SESSIONS = 64


@dataclass
class ToolboxFactory:
    """Maker of toolboxes whose stages are alike.

    Attributes:
        make_stage: Called once, when the first stage is needed.
        mode, budget, snapshots, patience, folder: Of each toolbox.
    """

    make_stage: Callable[[], Stage]
    mode: str = "host"
    budget: Budget = field(default_factory=Budget)
    snapshots: bool = True
    patience: float | None = 30.0
    folder: str | None = None

    def __post_init__(self) -> None:
        self._lock = threading.RLock()

    @cached_property
    def original(self) -> Stage:
        """The stage that all others are copies of; nobody moves it."""
        return self.make_stage()

    @cached_property
    def catalog(self) -> Toolbox:
        """A toolbox whose tools are those of every session; nobody calls them."""
        return self()

    def __call__(self) -> Toolbox:
        """Make a toolbox with a stage of its own."""
        with self._lock:  # a copy reads the original
            stage = copy.deepcopy(self.original)
        return Toolbox(
            stage, self.mode, self.budget, snapshots=self.snapshots, patience=self.patience, folder=self.folder
        )


@dataclass
class Session:
    """An open session.

    Attributes:
        box: Its toolbox.
        began_s, used_s: Clock when it began, and when it was last used.
        left_s: Clock when its client was seen to go; None: the client is there.
    """

    box: Toolbox
    began_s: float
    used_s: float
    left_s: float | None = None


class Sessions:
    """Sessions by a key that the transport gives. Safe to use from any thread.

    Args:
        make: Makes the toolbox of a new session.
        limit: Number of sessions at once.
        idle_s: Seconds without a call after which a session ends.
        grace_s: Seconds after its client has gone.
        life_s: Seconds that a session may last.
        clock: Returns seconds.
    """

    def __init__(
        self,
        make: Callable[[], Toolbox],
        limit: int = MAX_SESSIONS,
        idle_s: float = IDLE_S,
        grace_s: float = GRACE_S,
        life_s: float = LIFE_S,
        clock: Callable[[], float] = monotonic,
    ):
        self.make, self.limit, self.idle_s, self.grace_s, self.life_s = make, limit, idle_s, grace_s, life_s
        self._clock = clock
        self._open: dict[str, Session] = {}
        self._ended: deque[str] = deque(maxlen=MAX_REMEMBERED)
        self._lock = threading.RLock()

    def __contains__(self, key: str) -> bool:
        """Return whether the session has a stage."""
        return key in self._open

    def __len__(self) -> int:
        return len(self._open)

    def box(self, key: str) -> Toolbox:
        """Return the toolbox of a session, and open the session if it is new.

        Raises:
            StageError: The session has ended, or too many are open.
        """
        with self._lock:
            session = self._open.get(key)
            if session is None:
                if key in self._ended:
                    raise StageError(
                        "This session has ended: it was closed, silent for too long, or too old. Connect again; a new session "
                        "begins at power-up."
                    )
                self.close_due()
                if len(self._open) >= self.limit:
                    raise StageError(
                        f"{self.limit} sessions are open, which is the limit: close one, or try again later."
                    )
                now = self._clock()
                session = self._open[key] = Session(self.make(), now, now)
            session.used_s, session.left_s = self._clock(), None
            return session.box

    def note_disconnect(self, key: str) -> None:
        """Note that the client's connection broke: the session ends unless the client comes back within `grace_s`."""
        with self._lock:
            if key in self._open:
                self._open[key].left_s = self._clock()

    def cancel(self, key: str) -> None:
        """End the call that a session makes: its client no longer waits for it."""
        session = self._open.get(key)
        if session is not None:
            session.box.cancel()

    def close(self, key: str) -> None:
        """End a session, also in the middle of a call. Does nothing for one that is not open."""
        with self._lock:
            session = self._open.pop(key, None)
            if session is None:
                return
            self._ended.append(key)
        session.box.interrupt()
        session.box.close()

    def close_due(self) -> int:
        """End the sessions that are silent, abandoned or old, and return their number."""
        now = self._clock()
        with self._lock:
            due = [
                key
                for key, s in self._open.items()
                if now - s.used_s > self.idle_s
                or now - s.began_s > self.life_s
                or (s.left_s is not None and now - s.left_s > self.grace_s)
            ]
        for key in due:
            self.close(key)
        return len(due)

    def close_all(self) -> None:
        """End all sessions."""
        for key in tuple(self._open):
            self.close(key)
