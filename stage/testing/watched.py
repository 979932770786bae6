"""A stage that is recorded all the time, without an effect on the test."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

from stage.recording import Recording
from stage.sim.stage import Snapshot, Stage

KEPT = 3


class WatchedStage(Stage):
    """A Stage that records itself from `watch` to `unwatch`. Its own recording ends when the test records or restores
    it, and a new one begins afterwards.

    recordings: the last ones, in order. Copies of the stage are not watched.
    """

    recordings: Sequence[Recording] = ()
    _watched = False
    _own: Recording | None = None

    def watch(self) -> None:
        self._kept: deque[Recording] = deque(maxlen=KEPT)
        self.recordings = self._kept
        self._watched = True
        self._go_on()

    def unwatch(self) -> None:
        """The end; a recording that the test still makes is closed as well."""
        self._watched = False
        if self.recording is not None:
            self.recording.close()

    def _go_on(self) -> None:
        if self._watched and self.recording is None:
            self._own = super().record()
            self._own.on_error = "warn"  # a full disk is not the test's fault
            self._kept.append(self._own)

    def _give_way(self) -> None:
        if self._own is not None:
            own, self._own = self._own, None
            watched, self._watched = self._watched, False
            own.close()
            self._watched = watched
            if not has_something(own):
                self._kept.remove(own)

    def record(self, *args: Any, **kwargs: Any) -> Recording:
        self._give_way()
        try:
            recording = super().record(*args, **kwargs)
        finally:
            self._go_on()
        if self._watched:
            self._kept.append(recording)
        return recording

    def restore(self, snapshot: Snapshot) -> None:
        self._give_way()
        try:
            super().restore(snapshot)
        finally:
            self._go_on()

    def stop_recording(self) -> None:
        super().stop_recording()
        if self._own is not None:  # not by `_give_way`: there is no room for more
            self._own, self._watched = None, False
        self._go_on()


def has_something(recording: Recording) -> bool:
    """Time passed in it, or a bus cycle."""
    return bool(len(recording)) or any(len(journal.entries) for journal in recording.journals.values())
