"""`ClientSessions`: a toolbox for each client, created when the client first needs it, closed when the client leaves or is silent.

    sessions = ClientSessions(ToolboxFactory(lambda: Stage("xy")), limit=64, idle_s=600.0)
    sessions.get_toolbox("3f1c").call("home", {"axis": "x"})
    sessions.close("3f1c")

All stages are copies of one stage, so a new session takes only some milliseconds and does not load the model again.
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

MAX_REMEMBERED_SESSIONS = 1000  # sessions that ended, so that a late client gets a helpful error
IDLE_S, GRACE_S, LIFE_S = 600.0, 30.0, 8 * 3600.0
MAX_SESSIONS = 64


@dataclass
class ToolboxFactory:
    """Factory of toolboxes with equal stages.

    Attributes:
        make_stage: Function that returns the stage to copy; called when the first stage is needed.
        mode, budget, snapshots, patience, folder: Arguments of each `Toolbox`.
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
    def original_stage(self) -> Stage:
        """Stage that is copied for each session and never moved."""
        return self.make_stage()

    @cached_property
    def catalog(self) -> Toolbox:
        """Toolbox with the same tools as each session, only for listing them."""
        return self()

    def __call__(self) -> Toolbox:
        """Return a new toolbox with a stage of its own."""
        with self._lock:  # a copy reads the original
            stage = copy.deepcopy(self.original_stage)
        return Toolbox(
            stage, self.mode, self.budget, snapshots=self.snapshots, patience=self.patience, folder=self.folder
        )


@dataclass
class ClientSession:
    """Open session of a client.

    Attributes:
        box: Toolbox of the session.
        began_s: Clock time of the begin, s.
        used_s: Clock time of the last use, s.
        left_s: Clock time at which the connection of the client broke, s; None while it is connected.
    """

    box: Toolbox
    began_s: float
    used_s: float
    left_s: float | None = None


class ClientSessions:
    """Open sessions of all clients, by a key from the transport. Any thread may call the methods.

    Args:
        make: Function that returns the toolbox for a new session.
        limit: Greatest number of open sessions.
        idle_s: Time without a call after which a session ends, s.
        grace_s: Time after the client's disconnection after which its session ends, s.
        life_s: Longest duration of a session, s.
        clock: Function that returns the time, s.
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
        self._open: dict[str, ClientSession] = {}
        self._ended: deque[str] = deque(maxlen=MAX_REMEMBERED_SESSIONS)
        self._lock = threading.RLock()
        self._is_shut_down = False

    def __contains__(self, key: str) -> bool:
        """Return whether the session is open and thus has a stage."""
        return key in self._open

    def __len__(self) -> int:
        return len(self._open)

    def get_toolbox(self, key: str) -> Toolbox:
        """Return the toolbox of a session; open the session if it is new.

        Raises:
            StageError: The session has ended, too many are open, or the server ends.
        """
        with self._lock:
            session = self._open.get(key)
            if session is None:
                if self._is_shut_down:
                    raise StageError("The server ends, and opens no session any more. Start it again, then connect.")
                if key in self._ended:
                    raise StageError(
                        "This session has ended: it was closed, silent for too long, or too old. Connect again; a new session "
                        "begins at power-up."
                    )
                self.close_expired()
                if len(self._open) >= self.limit:
                    raise StageError(
                        f"{self.limit} sessions are open, which is the limit: close one, or try again later."
                    )
                now = self._clock()
                session = self._open[key] = ClientSession(self.make(), now, now)
            session.used_s, session.left_s = self._clock(), None
            return session.box

    def note_disconnect(self, key: str) -> None:
        """Store that the client's connection broke. The session ends unless the client comes back within `grace_s`."""
        with self._lock:
            if key in self._open:
                self._open[key].left_s = self._clock()

    def cancel_call(self, key: str) -> None:
        """End the running call of a session, because its client no longer waits for it."""
        session = self._open.get(key)
        if session is not None:
            session.box.cancel_call()

    def close(self, key: str) -> None:
        """End a session, even during a call. Does nothing if the session is not open."""
        with self._lock:
            session = self._open.pop(key, None)
            if session is None:
                return
            self._ended.append(key)
        session.box.request_session_end()
        session.box.close()

    def close_expired(self) -> int:
        """End the sessions that are idle, abandoned or too old; return their number."""
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

    def shut_down(self) -> None:
        """End all sessions and open no new ones, so that a call that has just come in does not delay the end of the server."""
        with self._lock:
            self._is_shut_down = True
        self.close_all()

    def close_all(self) -> None:
        """End all sessions."""
        for key in tuple(self._open):
            self.close(key)
