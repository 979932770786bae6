"""`Result`: what `tune` has found, as text, JSON, C and a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from os import PathLike
from typing import Any

from stage.support.identifiers import escape_name
from stage.tune.c_source import c_source
from stage.tune.looks import LOOK
from stage.tune.machines import Spread, find_spreads
from stage.tune.plans import Plan, Plans
from stage.tune.proof import Proof, gain
from stage.tune.task import Case, Task
from stage.tune.written import Cycle, Row, cycles, program, rows, said
from stage.units import PLACES, SMALL


@dataclass(frozen=True)
class Answer:
    """A plan and what was proved of it. name: formula or search; spare: kg on top of the payload without a lost step; more: nothing
    heavier was tried; holds: all of the proof, and the spare that was asked for."""

    name: str
    plan: Plan
    proof: Proof
    spare: float
    more: bool
    holds: bool


@dataclass(frozen=True)
class Result:
    """What was found. answers: that of the formula, and of the search if one passed the proof; won: the name of the one to take.

    by: search or formula, as asked. safety: factor of the formula. trials: that were made; stopped: Ctrl-C ended them. failed:
    answers of the search that did not pass moves that it had not seen. moves: that were made in all. cases: the moves of the proof,
    each with the machine that made it.
    """

    task: Task
    plans: Plans
    answers: tuple[Answer, ...]
    won: str
    safety: float
    by: str
    trials: int
    stopped: bool
    failed: int
    seed: int
    moves: int
    cases: tuple[Case, ...] = ()

    @property
    def answer(self) -> Answer:
        """The one to take."""
        return next(a for a in self.answers if a.name == self.won)

    @cached_property
    def cycles(self) -> list[Cycle]:
        """Its bus cycles, in order, of a move the way that was asked for."""
        return cycles(self.task, program(self.plans, self.answer.plan, self.task.signed))

    @cached_property
    def rows(self) -> list[Row]:
        """Its registers."""
        return rows(self.task, said(self.task, program(self.plans, self.answer.plan, self.task.signed)))

    def way(self) -> str:
        """The distance in words."""
        axis = self.task.stage.axes[self.task.axis]
        way = PLACES[axis.unit].text(self.task.signed * axis.meters_per_pulse, "g")
        return f"{way} ({self.task.signed} {'counts' if self.task.is_servo else 'pulses'})"

    def proved(self, a: Answer) -> str:
        """What the proof says of an answer, in words."""
        what = "arrives" if self.task.is_servo else "keeps step"
        failed = "" if a.proof.holds else "NOT proved: "
        return f"{failed}{what} in {a.proof.kept} of {a.proof.moves} drawn machines with up to {self.task.most:.3g} kg"

    @cached_property
    def spreads(self) -> dict[str, Spread]:
        """Ranges that the machines of the proof were drawn from, with those of the payload and of the rotor's angle."""
        return find_spreads(self.task.stage.axes[self.task.axis]) | {
            "payload": Spread(
                0.0, self.task.most, "kg", False, "as asked for, a quarter each with none, all, and all and the margin"
            ),
            "rotor angle": Spread(-0.5, 0.5, "electrical turns", False, "any"),
        }

    def describe_spreads(self) -> str:
        """Describe in a table what the machines of the proof were drawn from."""
        rows = [("a machine has", "drawn evenly from", "known from")]
        for name, spread in self.spreads.items():
            rows.append((name, f"{spread}{' (logarithm)' if spread.logarithmic else ''}", spread.evidence))
        width = max(len(drawn) for _, drawn, _ in rows) + 1
        return "\n".join(f"{name:15}{drawn:{width}}{known}" for name, drawn, known in rows)

    def claim(self) -> str:
        """State for which machines the registers hold, and how well the core loss of their motor is known."""
        motor, loss = self.task.stage.axes[self.task.axis].drive.motor.name, self.spreads.get("core loss")
        known = "" if loss is None else f" Core loss of the {motor}: {loss} ({loss.evidence.partition(': ')[2]})."
        return f"The axis {self.proved(self.answer)}, from the ranges above.{known}"

    def verdict(self) -> str:
        """Which to take, and why."""
        names = {a.name: a for a in self.answers}
        if self.by == "formula":
            return "The formula's registers; no search was asked for."
        searched = f"{self.trials} trials" + (", ended by Ctrl-C" if self.stopped else "")
        if "search" not in names:
            return f"The search ({searched}) found nothing that passes the proof: these are the formula's registers."
        saved, error = gain(names["formula"].proof, names["search"].proof)
        by = f"{saved * 1e3:.1f} ms (+- {error * 1e3:.1f} ms)"
        if self.won == "search":
            if not names["formula"].holds:
                return f"The search's registers ({searched}): the formula's lose steps in the proof."
            return f"The search's registers ({searched}) are faster than the formula's by {by}."
        return (
            f"The search ({searched}) gains {by}, which the proof cannot tell from nothing (it sees {LOOK * 1e3:g} ms): these are "
            "the formula's registers."
        )

    def __str__(self) -> str:
        task, axis = self.task, self.task.stage.axes[self.task.axis]
        chip = axis.chip.MAP.chip
        what = "" if task.judge_at is None else f"{task.judge_at} "
        arrived = f"arrived: {what}within {task.length(float(task.within or 0))} for {task.hold * 1e3:g} ms"
        lines = [
            f"axis {task.axis}, {chip}: {self.way()} {task.carries}, margin {task.spare:.3g} kg more; {arrived}",
            "",
            self.describe_spreads(),
            "",
            f"{'':9}{'arrives, mean':>15}{'worst':>11}{'too far':>11}{'spare payload':>15}  proof",
        ]
        for a in self.answers:
            p = a.proof
            spare = f"{'>= ' if a.more else ''}{a.spare:.2f} kg"
            far = SMALL[axis.unit].text(p.beyond, ".1f")
            lines.append(
                f"{a.name:9}{p.mean * 1e3:>12.1f} ms{p.worst * 1e3:>8.1f} ms{far:>11}{spare:>15}  {self.proved(a)}"
            )
        if self.failed:
            lines.append(
                f"{self.failed} of the search's best registers failed in moves that it had not seen, and are out."
            )
        lines += ["", self.verdict(), self.claim(), self.rates(), "", self.table(), "", self.listing()]
        return "\n".join(lines)

    def rates(self) -> str:
        """The rates and ramps that the registers are made for, in words."""
        s = self.answer.plan.speeds
        unit = "counts/s" if self.task.is_servo else "pps"
        start = f"from {s.start:,.0f} " if s.start else ""
        curved = ", S-curves" if s.s_curve else ""
        return f"They ask for {start}up to {s.drive:,.0f} {unit}, ramps of {s.up * 1e3:.1f} and {s.down * 1e3:.1f} ms{curved}."

    def table(self) -> str:
        """The registers."""
        wide = max((len(r.name) for r in self.rows), default=8)
        head = f"{'register':{max(wide, 8)}}{'value':>13}{'hex':>11}  meaning"
        out = [head, "-" * len(head)]
        for r in self.rows:
            mask = (1 << 4 * r.digits) - 1
            number = f"{r.value & mask:0{r.digits}X}h"
            out.append(f"{r.name:{max(wide, 8)}}{r.value:>13}{number:>11}  {r.words}")
        return "\n".join(out)

    def listing(self) -> str:
        """The bus cycles of a move the way that was asked for."""
        mask = self.task.stage.axes[self.task.axis].chip.DATA_MASK
        digits = (mask.bit_length() + 3) // 4
        out = ["address  data  what it says", "----------------------------"]
        for c in self.cycles:
            data = "" if c.address is None else f"{c.value & mask:0{digits}X}h"
            out.append(f"{'' if c.address is None else c.address:>7}  {data:>{digits + 1}}  {c.words}")
        return "\n".join(out)

    def c_source(self, name: str | None = None) -> str:
        """A C header with the bytes of the move; name: of its function, <name>_move."""
        task = self.task
        chip = task.stage.axes[task.axis].chip
        a = self.answer
        notes = [
            "",
            f"{self.proved(a)}; arrives after {a.proof.mean * 1e3:.1f} ms, {a.proof.worst * 1e3:.1f} ms at most",
            f"(by {'the data sheet formula' if a.name == 'formula' else 'search'}; stage tune, seed {self.seed})",
        ]
        title = f"axis {task.axis}, {chip.MAP.chip}: {self.way()} {task.carries}"
        return c_source(name or f"{escape_name(task.axis)}_tuned", title, notes, self.rows, self.cycles, chip)

    def json(self) -> dict[str, Any]:
        """All of it as numbers and texts: s, m, kg."""
        task = self.task
        return {
            "axis": task.axis,
            "chip": task.stage.axes[task.axis].chip.MAP.chip,
            "pulses": task.signed,
            "payload": task.payload,
            "spare": task.spare,
            "within": task.within,
            "hold": task.hold,
            "overshoot": task.overshoot if isfinite(task.overshoot or 0.0) else None,
            "judge_at": task.judge_at,
            "seed": self.seed,
            "trials": self.trials,
            "moves": self.moves,
            "stopped": self.stopped,
            "won": self.won,
            "verdict": self.verdict(),
            "claim": self.claim(),
            "answers": {
                a.name: {
                    "registers": a.plan.registers,
                    "speeds": {k: v for k, v in a.plan.speeds._asdict().items() if k != "second"},
                    "mean": a.proof.mean,
                    "worst": a.proof.worst,
                    "beyond": a.proof.beyond,
                    "spare": a.spare,
                    "spare_may_be_more": a.more,
                    "kept": a.proof.kept,
                    "proved": a.proof.moves,
                    "failed": a.proof.failed,
                }
                for a in self.answers
            },
            "drawn_from": {name: spread._asdict() for name, spread in self.spreads.items()},
            "machines": [
                {
                    **(case.machine or task.machine).values,
                    "payload": case.payload,
                    "rotor angle": case.beside / task.turn,
                    "way": case.way,
                }
                for case in self.cases
            ],
            "registers": [r._asdict() for r in self.rows],
            "bytes": [c._asdict() for c in self.cycles],
        }

    def plot(self, path: str | PathLike, overwrite: bool = False) -> None:
        """Draw rate, position and error over time, of all answers; see picture.py."""
        from stage.tune.picture import draw

        draw(self, path, overwrite)
