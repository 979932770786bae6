"""`Look`: what pages show of a stage, taken by its own thread at most FRAMES times a second, once for all browsers. No page.

look = Look(session)
look.axes["x"].position
look.want(0, 1); look.chips[0, 1].values["DV"]      registers only of what somebody looks at
look.traces[0].since(number)
"""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

from stage.chips.chip import Chip
from stage.panel.session import Session
from stage.panel.trace import Trace
from stage.sim.stage import Snapshot, Stage

FRAMES = 25
MOST_SENT = 200_000  # bus cycles of a program
WANTED = 2.0  # s for which the registers of a chip are looked at after somebody wanted them


class AxisSeen(NamedTuple):
    """position, commanded: m or rad; lost: full steps; switches: those of the stage, by name."""

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
        self.axes = {
            a.name: AxisSeen(a.position, a.commanded, a.lost_steps, a.switches.as_dict()) for a in stage.axes.values()
        }
        wanted = [key for key, at in tuple(self._wanted.items()) if now - at < WANTED]
        self.chips = {(k, axis): seen(stage.chips[k], axis) for k, axis in wanted}
        for trace in self.traces:
            trace.look()
        if stage.now < self.start[0] or sum(len(trace.sent or ()) for trace in self.traces) > MOST_SENT:
            self.start = self._begin(stage)
        self.number += 1

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
