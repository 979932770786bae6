"""`Budget`: how much an agent may do; `Meter` counts it where time passes and bus cycles are made, and ends what goes beyond.

What is spent stays spent: a snapshot that is restored gives nothing back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import monotonic
from typing import Any

from stage.errors import ArgumentError, StageError
from stage.sim.stage import Stage

SLICE = 250_000_000  # ns of simulated time between two looks at the clock on the wall
LONGEST = 120.0  # s of simulated time that a call may take


class Spent(StageError):
    """The budget has no more of this."""


@dataclass(frozen=True)
class Budget:
    """moves: that may be begun; seconds: of simulated time; cycles: of the bus. None: as many as one likes."""

    moves: int | None = None
    seconds: float | None = None
    cycles: int | None = None

    def __post_init__(self) -> None:
        for name in ("moves", "cycles"):
            n = getattr(self, name)
            if n is not None and (isinstance(n, bool) or not isinstance(n, int) or n < 0):
                raise ArgumentError(f"{name}={n!r}: a whole number, 0 or more, or None for no limit.")
        s = self.seconds
        if s is not None and (isinstance(s, bool) or not isinstance(s, int | float) or not 0 <= s < math.inf):
            raise ArgumentError(f"seconds={s!r}: 0 or more, or None for no limit.")


class Meter:
    """Counts for one stage. moves, cycles, ns: what is used; patience: s of real time that a call may take, None for any;
    longest: s of simulated time that a call may take; over, cancelled: the session is to end, this call is."""

    def __init__(self, stage: Stage, budget: Budget, patience: float | None = None, longest: float = LONGEST):
        self.budget, self.patience, self.longest = budget, patience, longest
        self.moves = self.cycles = self.ns = 0
        self.over = self.cancelled = False  # set by other threads: the session is to end, this call is
        self._stage = stage
        self._until_ns, self._until = 0, math.inf

    def begin(self) -> None:
        """A call begins: from now on time and cycles count."""
        self.cancelled = False
        self._until_ns = self.ns + round(self.longest * 1e9)
        self._until = math.inf if self.patience is None else monotonic() + self.patience
        self._stage.loop.pace, self._stage.loop.each_cycle = self._pace, self._cycle

    def end(self) -> None:
        """The call is over."""
        self._stage.loop.pace = self._stage.loop.each_cycle = None

    def undo_move(self) -> None:
        """It was refused before anything was done."""
        self.moves -= 1

    def move(self) -> None:
        """A move begins. Raises Spent."""
        if self.budget.moves is not None and self.moves >= self.budget.moves:
            raise Spent(f"all {self.budget.moves} moves are made. {self._now()}")
        self.moves += 1

    def left(self) -> dict[str, Any]:
        """What may still be used; null for no limit."""
        b = self.budget
        return {
            "moves": None if b.moves is None else b.moves - self.moves,
            "seconds": None if b.seconds is None else max(0.0, round(b.seconds - self.ns * 1e-9, 9)),
            "cycles": None if b.cycles is None else b.cycles - self.cycles,
        }

    def used(self) -> dict[str, Any]:
        """What has been used."""
        return {"moves": self.moves, "seconds": round(self.ns * 1e-9, 9), "cycles": self.cycles}

    def _cycle(self) -> None:
        if self.budget.cycles is not None and self.cycles >= self.budget.cycles:
            raise Spent(f"all {self.budget.cycles} bus cycles are made. {self._now()}")
        self.cycles += 1

    def _pace(self, until: int) -> int:
        """How far time may go now, of a run to `until`."""
        now = self._stage.state.now
        ends = [until, now + SLICE, now + self._until_ns - self.ns]
        limit = self.budget.seconds
        if limit is not None:
            ends.append(now + round(limit * 1e9) - self.ns)
        goal = max(min(ends), now)
        if goal == now < until:
            if limit is not None and self.ns >= round(limit * 1e9):
                raise Spent(f"all {limit:g} s of simulated time have passed. {self._now()}")
            raise StageError(
                f"one call may take {self.longest:g} s of simulated time, and that has passed; the stage stands as it is now. "
                "Ask for less, or call wait again and go on."
            )
        if self.cancelled:
            raise StageError("the call was cancelled; the stage stands as it is now.")
        if self.over:
            raise StageError("the session was ended while this call was made.")
        if monotonic() > self._until:
            raise StageError(
                f"one call may compute for {self.patience:g} s, and has; the stage stands as it is now. Ask for less at a time."
            )
        self.ns += goal - now
        return goal

    def _now(self) -> str:
        return "What needs no more of it can still be called: budget, registers, report, trace, diagnostics, picture."
