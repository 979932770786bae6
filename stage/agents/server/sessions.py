"""`Sessions`: a toolbox for each client that is connected, made when it first asks, gone when it ends or falls silent.

    sessions = Sessions(Maker(Stage("xy")), most=64, idle=600.0)
    sessions.box("3f1c").call("home", {"axis": "x"})
    sessions.close("3f1c")

All stages are copies of one, so a session costs some milliseconds and no second model file. No transport, no protocol.
"""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic

from stage.agents.budget import Budget
from stage.agents.recordings import Recordings
from stage.agents.toolbox import Toolbox
from stage.errors import StageError
from stage.sim.stage import Stage

REMEMBERED = 1000  # sessions that ended, of which a late caller is told
IDLE, GRACE, LIFE = 600.0, 30.0, 8 * 3600.0  # s
MOST = 64


@dataclass
class Maker:
    """Makes toolboxes of stages alike. stage: called once, when the first is needed. folder: where recordings may be written."""

    stage: Callable[[], Stage]
    mode: str = "host"
    budget: Budget = field(default_factory=Budget)
    snapshots: bool = True
    patience: float | None = 30.0
    folder: str | None = None

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._first: Stage | None = None
        self._catalogue: Toolbox | None = None

    @property
    def first(self) -> Stage:
        """The stage that all others are copies of; it is never moved."""
        with self._lock:
            if self._first is None:
                self._first = self.stage()
            return self._first

    @property
    def catalogue(self) -> Toolbox:
        """A toolbox to look at: its tools are those of every session."""
        first = self.first
        with self._lock:
            if self._catalogue is None:
                self._catalogue = self._box(copy.deepcopy(first))
            return self._catalogue

    def __call__(self) -> Toolbox:
        first = self.first
        with self._lock:  # a copy looks at the first
            twin = copy.deepcopy(first)
        return self._box(twin)

    def _box(self, stage: Stage) -> Toolbox:
        box = Toolbox(stage, self.mode, self.budget, snapshots=self.snapshots, patience=self.patience)
        Recordings(box, self.folder).join()
        return box


@dataclass
class Held:
    """A session. used, left: when it was used last, and when its client was seen to go; None: it is there."""

    box: Toolbox
    began: float
    used: float
    left: float | None = None


class Sessions:
    """By a key that the transport gives. most: at once; idle: s without a call after which one ends; grace: s after its client
    has gone; life: s that one may last. Safe to use from any thread."""

    def __init__(
        self,
        make: Callable[[], Toolbox],
        most: int = MOST,
        idle: float = IDLE,
        grace: float = GRACE,
        life: float = LIFE,
        clock: Callable[[], float] = monotonic,
    ):
        self.make, self.most, self.idle, self.grace, self.life, self._clock = make, most, idle, grace, life, clock
        self._held: dict[str, Held] = {}
        self._ended: deque[str] = deque(maxlen=REMEMBERED)
        self._lock = threading.RLock()

    def __contains__(self, key: str) -> bool:
        """It has a stage."""
        return key in self._held

    def __len__(self) -> int:
        return len(self._held)

    def box(self, key: str) -> Toolbox:
        """The toolbox of a session, made if it has none yet. Raises StageError for one that ended, and where there are too many."""
        with self._lock:
            held = self._held.get(key)
            if held is None:
                if key in self._ended:
                    raise StageError(
                        "this session has ended: it was closed, silent for too long, or too old. Connect again; a new session "
                        "begins at power-up."
                    )
                self.reap()
                if len(self._held) >= self.most:
                    raise StageError(
                        f"{self.most} sessions are open, and no more may be: close one, or try again later."
                    )
                now = self._clock()
                held = self._held[key] = Held(self.make(), now, now)
            held.used, held.left = self._clock(), None
            return held.box

    def gone(self, key: str) -> None:
        """The client's line has broken; if it does not come back within `grace`, the session ends."""
        with self._lock:
            if key in self._held:
                self._held[key].left = self._clock()

    def cancel(self, key: str) -> None:
        """Nobody waits any more for the call that a session makes."""
        held = self._held.get(key)
        if held is not None:
            held.box.cancel()

    def close(self, key: str) -> None:
        """End a session, also in the middle of a call. One that is not there ended before."""
        with self._lock:
            held = self._held.pop(key, None)
            if held is None:
                return
            self._ended.append(key)
        held.box.interrupt()
        held.box.close()

    def reap(self) -> int:
        """End those that are due; how many."""
        now = self._clock()
        with self._lock:
            due = [
                key
                for key, h in self._held.items()
                if now - h.used > self.idle
                or now - h.began > self.life
                or (h.left is not None and now - h.left > self.grace)
            ]
        for key in due:
            self.close(key)
        return len(due)

    def close_all(self) -> None:
        """End all."""
        for key in tuple(self._held):
            self.close(key)
