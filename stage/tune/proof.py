"""The proof of a plan: moves of machines that no search has seen, and how much more these would carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stage.tune.looks import LOOK
from stage.tune.machines import Machine
from stage.tune.plans import Plan
from stage.tune.task import Case
from stage.tune.tries import Tries

MOVES = 96
LADDER = 8  # payloads that are tried at once, six moves each
ANGLES = 6
FARTHEST = 4  # times the spare that was asked for: one of the payloads tried is just that


@dataclass(frozen=True)
class Proof:
    """How the moves of a proof ended, each made by a machine of its own.

    Attributes:
        moves: Number of moves.
        kept: Number of those that made all pulses and lost no step, and with up to the payload arrived without going too far.
        times: Seconds of the moves with up to the payload, NaN where not arrived; in the same order for all plans.
        beyond: Most that a move with up to the payload went too far, m.
        lost: Number of moves that did not keep step.
        failed: Indices of the moves that are not among `kept`.
    """

    moves: int
    kept: int
    times: np.ndarray
    beyond: float
    lost: int = 0
    failed: tuple[int, ...] = ()

    def said(self) -> str:
        """How the moves ended, in words."""
        late = self.moves - self.kept - self.lost
        ends = {"good": self.kept, "did not keep step": self.lost, "did not come to rest at the goal": late}
        return f"{self.moves} machines " + ", ".join(
            f"{n} {'were ' if end == 'good' else ''}{end}" for end, n in ends.items() if n
        )

    @property
    def holds(self) -> bool:
        return self.kept == self.moves

    @property
    def mean(self) -> float:
        return float(np.mean(self.times))

    @property
    def worst(self) -> float:
        return float(np.max(self.times))


def prove(tries: Tries, plans: Sequence[Plan], cases: Sequence[Case], limit: float) -> list[Proof]:
    """The same moves with each plan."""
    outcome = tries.make(plans, cases, limit)
    asked = tries.task.asked(list(cases))
    good, found = outcome.good(tries.task, asked), []
    for k in range(len(plans)):
        found.append(
            Proof(
                len(cases),
                int(good[k].sum()),
                outcome.arrived[k][asked],
                float(outcome.beyond[k][asked].max()),
                int((~outcome.kept[k]).sum()),
                tuple(np.flatnonzero(~good[k]).tolist()),
            )
        )
    return found


def spare(
    tries: Tries,
    plan: Plan,
    limit: float,
    rng: np.random.Generator,
    machines: Sequence[Machine | None] = (None,) * ANGLES,
) -> tuple[float, bool]:
    """Find how many kg on top of the payload a plan carries before it first loses a step; and whether it may be more.

    Two rounds of payloads, each with moves of the six `machines` at rotor angles all round, both ways.
    """
    task = tries.task
    low, high = 0.0, FARTHEST * float(task.spare or 0.1 * (task.payload + task.moved))
    for _ in range(2):
        steps = low + (high - low) / LADDER * np.arange(1, LADDER + 1)
        places = rng.uniform(-0.5, 0.5, (LADDER, ANGLES)) * task.turn
        cases = [
            Case(task.payload + float(kg), float(place), 1 - 2 * (j % 2), machine)
            for kg, row in zip(steps, places, strict=True)
            for j, (place, machine) in enumerate(zip(row, machines, strict=True))
        ]
        kept = tries.make([plan], cases, limit).kept.reshape(LADDER, ANGLES).all(axis=1)
        if kept.all():
            return high, low == 0.0
        first = int(np.argmin(kept))
        low, high = (low if first == 0 else float(steps[first - 1])), float(steps[first])
    return low, False


def gain(formula: Proof, found: Proof) -> tuple[float, float]:
    """By how much the second is faster, s, and twice the standard error of that, from the same moves with both."""
    saved = formula.times - found.times
    return float(np.mean(saved)), float(2 * np.std(saved, ddof=1) / np.sqrt(len(saved))) if len(saved) > 1 else LOOK
