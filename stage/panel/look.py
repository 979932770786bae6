"""`Look`: what pages show of a stage, taken by its own thread at most FRAMES times a second, once for all browsers. No page.

look = Look(session)
look.axes["x"].position
look.want(0, 1); look.chips[0, 1].values["DV"]      registers only of what somebody looks at
look.traces[0].since(number)
"""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stage.chips.chip import Chip
from stage.panel.session import Session
from stage.panel.trace import Trace
from stage.sim.stage import Snapshot, Stage

if TYPE_CHECKING:
    from stage.sim.axis import Axis

FRAMES = 25
MOST_SENT = 200_000  # bus cycles of a program
WANTED = 2.0  # s for which the registers of a chip are looked at after somebody wanted them


class AxisSeen(NamedTuple):
    """position, commanded: m or rad; lost: full steps, since the last origin return from a form; switches: those of the
    stage, by name."""

    position: float
    commanded: float
    lost: int | None
    switches: dict[str, bool]


class ChipSeen(NamedTuple):
    """values: of registers and words; inputs, outputs: pins by name, True is asserted."""

    values: dict[str, int]
    inputs: dict[str, bool]
    outputs: dict[str, bool]


class Look:
    """The latest look at a stage. Attributes are replaced, never changed, and can be read from any thread.

    Attributes: number: of looks so far; axes; chips: by index in `Stage.chips` and axis of the chip; traces: one a chip. start: the
    state in which the program of the traces' `sent` begins, and its time, ns; made anew where time goes back to before it.
    """

    def __init__(self, session: Session):
        self._session, self._wanted = session, {}  # type: ignore[var-annotated]
        self._at, self.number = 0.0, 0
        self._origins: dict[
            str, tuple[int, int]
        ] = {}  # when the origin was found, ns, and the steps that were lost by then
        self.axes: dict[str, AxisSeen] = {}
        self.chips: dict[tuple[int, int], ChipSeen] = {}
        self.traces: tuple[Trace, ...] = session.do(lambda stage: tuple(Trace(chip) for chip in stage.chips))
        self.start: tuple[int, Snapshot] = session.do(self._begin)
        session.do(self.take)
        self._end = session.on_slice(self._slice)

    def want(self, chip: int, axis: int) -> None:
        """Somebody looks at the registers of this axis: they are there after the next look, for WANTED seconds."""
        self._wanted[chip, axis] = perf_counter()

    def _slice(self, stage: Stage) -> None:
        if perf_counter() - self._at >= 1 / FRAMES:
            self.take(stage)

    def take(self, stage: Stage) -> None:
        """Look now, in the stage's thread."""
        self._at = now = perf_counter()
        self.axes = {a.name: self._seen(a) for a in stage.axes.values()}
        wanted = [key for key, at in tuple(self._wanted.items()) if now - at < WANTED]
        self.chips = {(k, axis): seen(stage.chips[k], axis) for k, axis in wanted}
        for trace in self.traces:
            trace.look()
        if stage.now < self.start[0] or sum(len(trace.sent or ()) for trace in self.traces) > MOST_SENT:
            self.start = self._begin(stage)
        self.number += 1

    def found_origin(self, axis: str, stage: Stage) -> None:
        """An origin return has found where the carriage is: what was lost before is lost no more. In the stage's thread."""
        self._origins[axis] = stage.now, stage.axes[axis].lost_steps

    def _seen(self, axis: Axis) -> AxisSeen:
        when, before = self._origins.get(axis.name, (0, 0))
        if axis.stage.now < when:  # somebody went back in time
            before = 0
            del self._origins[axis.name]
        lost, commanded = axis.lost_steps, axis.commanded
        if before:
            record, _ = axis.electrics()
            commanded -= before * (np.pi / 2 / record.teeth) / axis.gear
        return AxisSeen(axis.position, commanded, lost - before, axis.switches.as_dict())

    def _begin(self, stage: Stage) -> tuple[int, Snapshot]:
        for trace in self.traces:
            trace.sent = []
        return stage.now, stage.snapshot()

    def close(self) -> None:
        """Look no more."""
        self._end()
        for trace in self.traces:
            trace.close()


def seen(chip: Chip, axis: int) -> ChipSeen:
    """What one axis of a chip shows now."""
    inputs, outputs = chip.input_word(axis), chip.output_word(axis)
    return ChipSeen(
        chip.values_of(axis),
        {name: bool(inputs & bit) for name, bit in chip.INPUTS.items()},
        {name: bool(outputs & bit) for name, bit in chip.OUTPUTS.items()},
    )
