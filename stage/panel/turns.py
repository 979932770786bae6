"""`Turns`: whose turn it is at a stage, that of its session's thread or that of programs. No page, and no stage.

    turns.admit()                  in a program, before it does anything with the stage: gives way where the session wants it
    if turns.claim(0.02): ...      in the session's thread: no program is at the stage now, nor comes until `release`

A program is at the stage from where it is admitted until it is back in code of its own: that is read from its stack, so that nobody
pays for a lock in each bus cycle. What it does there is therefore never cut into by the session, be it a bus cycle or a whole
procedure; a procedure lets time pass, and gives way there.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from time import perf_counter
from types import FrameType

AT_THE_STAGE = tuple(
    f"stage.{part}" for part in ("sim.", "chips.", "drives.", "firmware.", "board.", "targets.", "serve.machine", "recording.")
)  # fmt: skip
"""Modules below which code is at the stage."""
LOOK = 0.001  # s between looks at whether a program has left


class Turns:
    """Of one stage."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._claimed = False
        self._programs: set[int] = set()
        self._resting: set[int] = set()

    # --- for programs ---

    def admit(self) -> None:
        """This thread's program is about to do something with the stage. Waits for as long as the session has it."""
        self._programs.add(
            threading.get_ident()
        )  # before the look: from here on it is at the stage, for whoever claims it now
        if self._claimed:
            self.rest(0.0)

    def rest(self, seconds: float) -> None:
        """This thread's program waits: for so long or until something has changed, and for as long as the session has the stage."""
        with self.resting(), self._changed:
            if seconds > 0:
                self._changed.wait(seconds)

    @contextmanager
    def resting(self, goes_on: bool = True) -> Iterator[None]:
        """In this block the program of this thread keeps off the stage. goes_on: after it, it is at the stage, and waits until it
        may be. Of other threads nothing is asked."""
        me = threading.get_ident()
        if me not in self._programs:
            yield
            return
        with self._changed:
            self._resting.add(me)
        try:
            yield
            with self._changed:
                if goes_on:
                    self._changed.wait_for(lambda: not (self._claimed and me in self._programs))
                self._resting.discard(me)  # before anybody can claim it
        finally:  # Ctrl-C, too, which ends the wait
            self._resting.discard(me)

    def asking(self) -> AbstractContextManager[None]:
        """As `resting`, while this thread's program has somebody else do something."""
        return self.resting(goes_on=_at_the_stage(sys._getframe()))

    @property
    def waiting(self) -> bool:
        """Some program waits for the session to give the stage back."""
        return self._claimed and bool(self._resting)

    def forget(self) -> None:
        """There is no program any more."""
        with self._changed:
            self._programs.clear()
            self._changed.notify_all()

    # --- for the session's thread ---

    def claim(self, patience: float, given_up: Callable[[], bool] = lambda: False) -> bool:
        """The stage is the session's now, until `release`; False where a program has not given way in so many seconds."""
        with self._changed:
            self._claimed = True
        end = perf_counter() + patience
        while self._inside():
            if perf_counter() > end or given_up():
                self.release()
                return False
            with self._changed:
                self._changed.wait(LOOK)
        return True

    def release(self) -> None:
        """It is the programs' again."""
        with self._changed:
            self._claimed = False
            self._changed.notify_all()

    def ring(self) -> None:
        """Programs that rest look again at what they wait for."""
        with self._changed:
            self._changed.notify_all()

    def _inside(self) -> bool:
        """Whether some program is at the stage. With the GIL held no thread moves while we look."""
        frames = sys._current_frames()
        for thread in tuple(self._programs):
            frame = frames.get(thread)
            if frame is None:
                self._programs.discard(thread)  # it has ended
            elif thread not in self._resting and _at_the_stage(frame):
                return True
        return False


def _at_the_stage(frame: FrameType | None) -> bool:
    """Whether a frame, or one of those that have called it, is of a module at the stage."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith(AT_THE_STAGE):
            return True
        frame = frame.f_back
    return False
