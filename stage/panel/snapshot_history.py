"""`SnapshotHistory`: the snapshots of the last half minute, with which a session goes back in time."""

from __future__ import annotations

from collections import deque

from stage.sim.stage import Snapshot, Stage
from stage.support.snapshots import SnapshotHeader

MAX_AGE_S = 30.0  # simulated seconds that a session can go back
INTERVAL_S = 0.05  # simulated seconds between two snapshots


class SnapshotHistory:
    """Snapshots of one stage by their times, ns. Only one thread at a time may call the methods.

    Attributes:
        oldest: Time of the oldest snapshot, ns; None without snapshots. Any thread may read it.
    """

    def __init__(self) -> None:
        self._snapshots: deque[tuple[int, Snapshot]] = deque()
        self.oldest: int | None = None

    def take_snapshot_if_due(self, stage: Stage) -> None:
        """Take a snapshot if the newest one is at least INTERVAL_S old, and drop snapshots older than MAX_AGE_S."""
        snapshots, now = self._snapshots, stage.now
        if snapshots and now - snapshots[-1][0] < INTERVAL_S * 1e9:
            return
        snapshots.append((now, stage.snapshot()))
        while now - snapshots[0][0] > MAX_AGE_S * 1e9 and len(snapshots) > 1:
            snapshots.popleft()
        self.oldest = snapshots[0][0]

    def find_latest_before(self, goal: int) -> Snapshot | None:
        """Return the newest snapshot at or before the time `goal`, ns, or else the oldest one; None without snapshots."""
        snapshots = self._snapshots
        oldest = snapshots[0][1] if snapshots else None
        return next((snapshot for time, snapshot in reversed(snapshots) if time <= goal), oldest)

    def find_oldest_of(self, header: SnapshotHeader) -> Snapshot | None:
        """Return the oldest snapshot since which the machine has had this `header`; None if the newest snapshot has another one."""
        oldest = None
        for _, snapshot in reversed(self._snapshots):
            if snapshot.header != header:
                break
            oldest = snapshot
        return oldest

    def forget_after(self, now: int) -> None:
        """Drop the snapshots that are later than `now`, ns."""
        while self._snapshots and self._snapshots[-1][0] > now:
            self._snapshots.pop()
        if not self._snapshots:
            self.oldest = None
