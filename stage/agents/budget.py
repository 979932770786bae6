"""`Budget`: how much an agent may do. `Meter`: counts it where time passes and bus cycles happen, and stops what exceeds it.

Restoring a snapshot gives nothing back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import monotonic
from typing import Any

from stage.errors import ArgumentError, StageError
from stage.sim.stage import Stage
from stage.support.argument_checks import check_integer

CHECK_INTERVAL_NS = 250_000_000  # simulated time between two looks at the wall clock
CALL_LIMIT_S = 120.0  # simulated time that one call may take


class BudgetSpent(StageError):
    """The agent has used all that the budget allows of something."""


@dataclass(frozen=True)
class Budget:
    """What an agent may use; None stands for no limit.

    Attributes:
        moves: Moves that it may begin.
        seconds: Simulated time.
        cycles: Bus cycles.
    """

    moves: int | None = None
    seconds: float | None = None
    cycles: int | None = None

    def __post_init__(self) -> None:
        for name in ("moves", "cycles"):
            if getattr(self, name) is not None:
                check_integer(name, getattr(self, name), 0)
        s = self.seconds
        if s is not None and (isinstance(s, bool) or not isinstance(s, int | float) or not 0 <= s < math.inf):
            raise ArgumentError(f"seconds={s!r} must be a number, 0 or more, or None for no limit.")


class Meter:
    """Counter of what an agent uses of one stage.

    Args:
        stage: The stage that the agent drives.
        budget: What the agent may use.
        patience: Real seconds that a call may take; None for any.

    Attributes:
        moves, cycles, ns: Used so far: moves, bus cycles, nanoseconds of simulated time.
        call_limit_s: Simulated seconds that one call may take.
        session_ended, call_cancelled: Set by other threads: the session is to end; the call that runs is to end.
    """

    def __init__(self, stage: Stage, budget: Budget, patience: float | None = None):
        self.budget, self.patience, self.call_limit_s = budget, patience, CALL_LIMIT_S
        self.moves = self.cycles = self.ns = 0
        self.session_ended = self.call_cancelled = False
        self._stage = stage
        self._call_end_ns, self._deadline = 0, math.inf

    def begin(self) -> None:
        """Begin a call: from now on, time and cycles count."""
        self.call_cancelled = False
        self._call_end_ns = self.ns + round(self.call_limit_s * 1e9)
        self._deadline = math.inf if self.patience is None else monotonic() + self.patience
        self._stage.loop.pace, self._stage.loop.each_cycle = self._advance, self._count_cycle

    def end(self) -> None:
        """End the call."""
        self._stage.loop.pace = self._stage.loop.each_cycle = None

    def count_move(self) -> None:
        """Count a move that begins. Raises BudgetSpent."""
        if self.budget.moves is not None and self.moves >= self.budget.moves:
            raise BudgetSpent(f"All {self.budget.moves} moves are spent. {STILL_FREE}")
        self.moves += 1

    def left(self) -> dict[str, Any]:
        """Return what the agent may still use; None for no limit."""
        used, allowed = self.used(), vars(self.budget)
        return {
            n: None if most is None else max(round(most - used[n], 9), 0) + 0 for n, most in allowed.items()
        }  # no -0.0

    def used(self) -> dict[str, Any]:
        """Return what the agent has used."""
        return {"moves": self.moves, "seconds": round(self.ns * 1e-9, 9), "cycles": self.cycles}

    def _count_cycle(self) -> None:
        if self.budget.cycles is not None and self.cycles >= self.budget.cycles:
            raise BudgetSpent(f"All {self.budget.cycles} bus cycles are spent. {STILL_FREE}")
        self.cycles += 1

    def _advance(self, until: int) -> int:
        """Return the time, ns, to which a run to `until` may go now. Raises StageError."""
        now = self._stage.state.now
        budget_ns = math.inf if self.budget.seconds is None else round(self.budget.seconds * 1e9)
        allowed = min(until - now, CHECK_INTERVAL_NS, self._call_end_ns - self.ns, budget_ns - self.ns)
        if allowed <= 0 < until - now:
            if self.ns >= budget_ns:
                raise BudgetSpent(f"All {self.budget.seconds:g} s of simulated time are spent. {STILL_FREE}")
            raise StageError(
                f"One call may take {self.call_limit_s:g} s of simulated time, which have passed; the stage keeps its state. "
                "Ask for less, or go on with another wait."
            )
        if self.call_cancelled:
            raise StageError("The client cancelled the call; the stage keeps its state.")
        if self.session_ended:
            raise StageError("The session ended during this call.")
        if monotonic() > self._deadline:
            raise StageError(
                f"One call may compute for {self.patience:g} s, which have passed; the stage keeps its state. "
                "Ask for less at a time."
            )
        step = max(int(allowed), 0)
        self.ns += step
        return now + step


STILL_FREE = "Tools that need none of it still answer: budget, registers, report, trace, diagnostics, picture."
