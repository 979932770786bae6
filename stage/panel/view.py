"""`Views`: what was at a stage after its last slice of time, and who is told of it. No page."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from stage.sim.stage import Stage


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


class Views:
    """Attributes: last: the newest; changed: a Condition, notified when there is one; at: its time, ns, -1 before the first."""

    def __init__(self, stage: Stage, pace: float):
        self.changed = threading.Condition()
        self.at = -1
        self._looks: list[Callable[[Stage], None]] = []
        self.last = View(0, stage.time, pace, "", "", np.array(stage.data.qpos))

    def on_slice(self, look: Callable[[Stage], None]) -> Callable[[], None]:
        """Have `look(stage)` called at each; returns what ends it."""
        self._looks.append(look)

        def end() -> None:
            if look in self._looks:  # it may have ended already
                self._looks.remove(look)

        return end

    def publish(self, stage: Stage, pace: float, doing: str, trouble: str) -> None:
        """What is there now."""
        self.at = stage.now
        self.last = View(self.last.number + 1, stage.time, pace, doing, trouble, np.array(stage.data.qpos))
        for look in tuple(self._looks):
            look(stage)
        with self.changed:
            self.changed.notify_all()
