"""`Budget`: limits of what an agent may use. `Meter`: counts simulated time and bus cycles as they pass, and enforces the limits.

Restoring a snapshot does not restore the budget.
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


class BudgetExhaustedError(StageError):
    """Error of a call for which the budget has no moves, bus cycles or simulated time left."""


@dataclass(frozen=True)
class Budget:
    """Limits of what an agent may use; None: no limit.

    Attributes:
        moves: Number of moves that the agent may begin.
        seconds: Simulated time, s.
        cycles: Number of bus cycles.
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


class BudgetMeter:
    """Counter of what an agent uses of one stage, which ends a call that exceeds a limit.

    Args:
        stage: The stage that the agent drives.
        budget: Limits of what the agent may use.
        patience: Longest real time that a call may take, s; None: no limit.

    Attributes:
        moves, cycles, ns: Moves, bus cycles and nanoseconds of simulated time used so far.
        call_limit_s: Longest simulated time that one call may take, s.
        session_ended: Set by another thread to end the running call with the session.
        call_cancelled: Set by another thread to end the running call.
    """

    def __init__(self, stage: Stage, budget: Budget, patience: float | None = None):
        self.budget, self.patience, self.call_limit_s = budget, patience, CALL_LIMIT_S
        self.moves = self.cycles = self.ns = 0
        self.session_ended = self.call_cancelled = False
        self._stage = stage
        self._call_end_ns, self._deadline = 0, math.inf

    def begin_call(self) -> None:
        """Begin a call: count simulated time and bus cycles from now on."""
        self.call_cancelled = False
        self._call_end_ns = self.ns + round(self.call_limit_s * 1e9)
        self._deadline = math.inf if self.patience is None else monotonic() + self.patience
        self._stage.loop.pace, self._stage.loop.each_cycle = self._limit_advance, self._count_cycle

    def end_call(self) -> None:
        """End a call: stop counting."""
        self._stage.loop.pace = self._stage.loop.each_cycle = None

    def count_move(self) -> None:
        """Count a move that is about to begin. Raises BudgetExhaustedError if no move is left."""
        if self.budget.moves is not None and self.moves >= self.budget.moves:
            raise BudgetExhaustedError(f"All {self.budget.moves} moves are spent. {FREE_TOOLS_HINT}")
        self.moves += 1

    def list_remaining(self) -> dict[str, Any]:
        """Return what the agent may still use, by the names of the budget; None: no limit."""
        used, allowed = self.list_used(), vars(self.budget)
        # + 0: no -0.0
        return {n: None if most is None else max(round(most - used[n], 9), 0) + 0 for n, most in allowed.items()}

    def list_used(self) -> dict[str, Any]:
        """Return what the agent has used, by the names of the budget."""
        return {"moves": self.moves, "seconds": round(self.ns * 1e-9, 9), "cycles": self.cycles}

    def _count_cycle(self) -> None:
        """Count a bus cycle that is about to be made. Raises BudgetExhaustedError if no cycle is left."""
        if self.budget.cycles is not None and self.cycles >= self.budget.cycles:
            raise BudgetExhaustedError(f"All {self.budget.cycles} bus cycles are spent. {FREE_TOOLS_HINT}")
        self.cycles += 1

    def _limit_advance(self, until: int) -> int:
        """Return the time, ns, to which a run towards `until`, ns, may go now. Raises StageError if the call has to end."""
        now = self._stage.state.now
        budget_ns = math.inf if self.budget.seconds is None else round(self.budget.seconds * 1e9)
        allowed = min(until - now, CHECK_INTERVAL_NS, self._call_end_ns - self.ns, budget_ns - self.ns)
        if allowed <= 0 < until - now:
            if self.ns >= budget_ns:
                raise BudgetExhaustedError(
                    f"All {self.budget.seconds:g} s of simulated time are spent. {FREE_TOOLS_HINT}"
                )
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


FREE_TOOLS_HINT = "Tools that need none of it still answer: budget, registers, report, trace, diagnostics, picture."
