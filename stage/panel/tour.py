"""A tour in six steps for somebody who never saw such a chip: each waits until he has done it himself. No page.

The tour looks at the stage after each slice of a session and knows what is happening from pulses, switches and the rotor alone,
whoever gave the orders and whatever the chips are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

SAMPLE = 0.0199  # s of simulated time over which a rate is taken, at least: a slice at the usual speed
LONGEST = 4000  # rates of a drive that are remembered
STEADY = 0.03  # of a rate: as much is constant
PLATEAU = 3  # rates that are equal, at least
QUIET = 0.08  # s without a pulse end a drive; asking the chip would take a bus cycle
TOGETHER = 0.1  # s: ends of axes that are one


@dataclass
class Run:
    """Run of an axis, from rest to rest.

    Attributes:
        rates: Pulses a second, without a sign, every SAMPLE.
        began, ended: s.
        org: The origin switch was on.
        before: It began before the step that waits.
    """

    rates: list[float] = field(default_factory=list)
    began: float = 0.0
    ended: float = 0.0
    org: bool = False
    before: bool = False

    def plateaus(self) -> list[float]:
        """Return the rates that were kept for a while, in their order."""
        kept: list[float] = []
        for k in range(len(self.rates) - PLATEAU + 1):
            part = self.rates[k : k + PLATEAU]
            if max(part) - min(part) <= STEADY * max(part) and (not kept or abs(part[0] - kept[-1]) > 0.2 * kept[-1]):
                kept.append(part[0])
        return kept


@dataclass(frozen=True)
class Step:
    """Step of the tour.

    Attributes:
        title, task: For the reader.
        sheet: What data sheets call it.
        done: Returns whether it has happened.
    """

    title: str
    task: str
    sheet: str
    done: Callable[[Tour], bool]


class Tour:
    """Watches a session until the last step is done, or `close`.

    Attributes:
        number: of the step that waits, from 0; len(STEPS) when all are done.
    """

    def __init__(self, session: Session):
        self.number = 0
        self.finished: list[tuple[str, Run]] = []
        self.lost = False
        self._under_way: dict[str, Run] = {}
        self._nets: dict[str, tuple[float, float]] = {}
        self._lost_at_first: dict[str, int] = {}
        self._end = session.on_slice(self.look)

    @property
    def step(self) -> Step | None:
        """Step that waits; None when all are done."""
        return STEPS[self.number] if self.number < len(STEPS) else None

    def skip(self) -> None:
        """Go on to the next step."""
        self.number = min(self.number + 1, len(STEPS))
        self._forget()

    def close(self) -> None:
        """Watch no longer."""
        self._end()

    def look(self, stage: Stage) -> None:
        """Watch the stage after a slice, in its thread."""
        for axis in stage.axes.values():
            self._follow(axis, stage.time)
        step = self.step
        if step is not None and step.done(self):
            self.skip()

    def pulses(self) -> bool:
        """Return whether some axis runs, or has run since the step began."""
        return bool(self.finished or self._under_way)

    def _forget(self) -> None:
        self.finished, self.lost = [], False
        self._lost_at_first.clear()
        for drive in self._under_way.values():
            drive.before = True

    def _follow(self, axis: Axis, now: float) -> None:
        _, net = axis.read_drive()
        before, then = self._nets.get(axis.name, (net, now))
        lost = axis.lost_steps
        self.lost |= lost != self._lost_at_first.setdefault(axis.name, lost)
        if now < then:  # somebody went back in time
            self._under_way.pop(axis.name, None)
        elif now - then < SAMPLE:
            self._nets.setdefault(axis.name, (net, now))
            return
        else:
            drive = self._under_way.get(axis.name)
            if net != before and drive is None:
                drive = self._under_way[axis.name] = Run(began=then)
            if drive is not None:
                drive.org |= bool(axis.switches.as_dict().get("org"))
                if net != before:
                    drive.rates.append(abs(net - before) / (now - then))
                    del drive.rates[:-LONGEST]
                    drive.ended = now
                elif now - drive.ended >= QUIET:
                    del self._under_way[axis.name]
                    if not drive.before:
                        self.finished.append((axis.name, drive))
                        del self.finished[:-16]
        self._nets[axis.name] = net, now


def _ramp(tour: Tour) -> bool:
    """Return whether a run began slower than it went later, and was slower again before its end."""
    return any(len(d.rates) >= 3 and max(d.rates[0], d.rates[-1]) < 0.8 * max(d.rates) for _, d in tour.finished)


def _two_rates(tour: Tour) -> bool:
    """Return whether a run went from one constant rate up to another; an origin return goes down only."""
    return any(a < b for _, d in tour.finished for a, b in pairwise(d.plateaus()))


def _together(tour: Tour) -> bool:
    """Return whether two axes ran at the same time and ended as one."""
    return any(
        a != b and abs(d.ended - e.ended) <= TOGETHER and min(d.ended, e.ended) > max(d.began, e.began)
        for (a, d), (b, e) in pairwise(tour.finished)
    )


STEPS = (
    Step(
        "First pulse",
        "Make an axis move. With bytes: open the front panel of a chip, write its registers and press a start command. With a "
        "form: Move, 1 mm.",
        "Preset or positioning operation: the chip gives out as many pulses as its pulse register says, and each pulse turns the "
        "motor by one microstep.",
        Tour.pulses,
    ),
    Step(
        "Ramp",
        "Move 20 mm or more, and look at the rate on the oscilloscope: it rises, stays, and falls again.",
        "High-speed operation with ramp-up and ramp-down, from the initial speed (FL, SV) to the drive speed (FH, V) at an "
        "acceleration rate.",
        _ramp,
    ),
    Step(
        "Stall",
        "Ask for more than the motor can: a much higher drive speed, a much shorter ramp, or 20 kg of payload. The pulses go on "
        "and the carriage does not: lost steps. The chip cannot know.",
        "Pull-out torque: beyond it a stepper loses synchronism, by four full steps at a time. Data sheets of motors have a curve.",
        lambda tour: tour.lost,
    ),
    Step(
        "Origin return",
        "After lost steps nobody knows where the carriage is. Find the origin again: Home.",
        "Origin return, home position search: the chip drives until the ORG (home, STOP) input becomes active.",
        lambda tour: any(d.org for _, d in tour.finished),
    ),
    Step(
        "Dual rate",
        "Move at one speed, change to another on the way, and back: Two rates.",
        "FH1 and FH2, or a drive speed that is written while driving: the chip ramps from the one to the other.",
        _two_rates,
    ),
    Step(
        "Synchronized move",
        "Drive two axes so that they begin and end together: Line, 30 mm by 10 mm.",
        "Linear interpolation, or two chips with rates as a : b, started by one command (CSTA, STA, one write to both).",
        _together,
    ),
)
