"""What a plan is on the bus: the cycles in order, with words, and the registers that they leave."""

from __future__ import annotations

from typing import Any, NamedTuple

from stage.chips.describe import Statement, decode
from stage.sim.fleet import Fleet
from stage.sim.program import WAIT, WRITE, Program
from stage.tune.plans import Plan, Plans
from stage.tune.task import Task


class Cycle(NamedTuple):
    """A write of the chip's bus, or, where address is None, a wait of `value` ns. words: what it says."""

    address: int | None
    value: int
    words: str


class Row(NamedTuple):
    """A register: as a host writes it. digits: of its value in hexadecimal."""

    name: str
    value: int
    digits: int
    meaning: str
    unit: str

    @property
    def words(self) -> str:
        """Meaning and unit."""
        return f"{self.meaning}, {self.unit}" if self.unit and self.unit not in self.meaning else self.meaning


def program(plans: Plans, plan: Plan, pulses: int) -> Program:
    """The move from power-up on."""
    made = Program()
    plans.write(made, plan, pulses)
    return made


def cycles(task: Task, made: Program) -> list[Cycle]:
    """The bus cycles of a program, in order."""
    listener = task.copy().axes[task.axis].chip.listener()
    out = []
    for kind, a, b, c in made.ops:
        if kind == WRITE:
            out.append(Cycle(b, c, listener.write(b, c)))
        elif kind == WAIT:
            out.append(Cycle(None, a, f"wait {a * 1e-6:g} ms"))
    return out


def said(task: Task, made: Program) -> list[Statement]:
    """The same as commands and whole registers."""
    stage = task.copy()
    axis: Any = stage.axes[task.axis]
    journal = axis.chip.journal(axis.chip_axis)
    fleet = Fleet([stage], 1)
    fleet.play([made])
    fleet.close()
    journal.close()
    return decode(axis.chip.decoder(axis.chip_axis), journal.entries)


def rows(task: Task, sayings: list[Statement]) -> list[Row]:
    """The registers that were written, the last value of each."""
    map_ = task.stage.axes[task.axis].chip.MAP
    found: dict[str, Row] = {}
    for s in sayings:
        if s.kind != "register" or not s.register:
            continue
        r: Any = next((place for place in map_.places if place.name == s.register), None)
        if r is not None:  # the same register again is the last in order
            found.pop(r.name, None)
            found[r.name] = Row(r.name, s.value, (r.bits + 3) // 4, r.text, getattr(r, "unit", ""))
    return list(found.values())
