"""`Past`: the snapshots of the last while, by which one goes back."""

from __future__ import annotations

from collections import deque

from stage.sim.stage import Snapshot, Stage
from stage.snapshots import Header

KEPT = 30.0  # s of simulated time that one can go back
EVERY = 0.05  # s of simulated time between the snapshots for it


class Past:
    """Of one stage. All but `seconds` are called by whose turn it is."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, Snapshot]] = deque()

    def remember(self, stage: Stage) -> None:
        """A snapshot, where the last is EVERY old."""
        kept, now = self._kept, stage.now
        if kept and now - kept[-1][0] < EVERY * 1e9:
            return
        kept.append((now, stage.snapshot()))
        while now - kept[0][0] > KEPT * 1e9 and len(kept) > 1:
            kept.popleft()

    def before(self, goal: int) -> Snapshot | None:
        """The last that is of `goal` (ns) or earlier, or the oldest. None where there is none."""
        kept = self._kept
        return next((snapshot for at, snapshot in reversed(kept) if at <= goal), kept[0][1] if kept else None)

    def oldest_of(self, header: Header) -> Snapshot | None:
        """The oldest from which on the machine has been this one, of which its snapshots are."""
        found = None
        for _, snapshot in reversed(self._kept):
            if snapshot.header != header:
                break
            found = snapshot
        return found

    def forget_after(self, now: int) -> None:
        """What then lies in the future."""
        while self._kept and self._kept[-1][0] > now:
            self._kept.pop()

    def seconds(self, now: int) -> float:
        """How far one can go back from `now`, ns; s."""
        kept = self._kept
        return (now - kept[0][0]) * 1e-9 if kept else 0.0
