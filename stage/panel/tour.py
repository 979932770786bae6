"""Tour in six steps for users who have never seen such a chip: each step waits until the user has done it.

This module draws no page.

The tour observes the stage after each slice of a session. It recognizes a step only by pulses, switches and the rotor, whatever
the chips are and whoever writes to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stage.panel.session import Session
    from stage.sim.axis import Axis
    from stage.sim.stage import Stage

SAMPLE_TIME_S = 0.0199  # simulated time over which a rate is taken, at least: a slice at the usual speed
MAX_RATES = 4000  # of a run
STEADY_FRACTION = 0.03  # by which the rates of a plateau differ at most
MIN_PLATEAU = 3  # rates
MAX_RUNS = 16
QUIET_TIME_S = 0.08  # without a pulse after which a run is over; a read of the status would take a bus cycle
SIMULTANEITY_S = 0.1  # by which the ends of two axes differ at most


@dataclass
class AxisMotion:
    """Motion of an axis, from rest to rest.

    Attributes:
        rates: Pulse rates without sign, pps, every SAMPLE_TIME_S.
        begin, end: Times of the first and the last pulse, s.
        saw_org: Whether the origin switch ORG was on at any time of the motion.
        began_before_step: Whether the motion began before the present step of the tour.
    """

    rates: list[float] = field(default_factory=list)
    begin: float = 0.0
    end: float = 0.0
    saw_org: bool = False
    began_before_step: bool = False

    def list_plateaus(self) -> list[float]:
        """Return the rates, pps, at which the motion was constant for a while, in order of time."""
        plateaus: list[float] = []
        for k in range(len(self.rates) - MIN_PLATEAU + 1):
            part = self.rates[k : k + MIN_PLATEAU]
            is_steady = max(part) - min(part) <= STEADY_FRACTION * max(part)
            if is_steady and (not plateaus or abs(part[0] - plateaus[-1]) > 0.2 * plateaus[-1]):
                plateaus.append(part[0])
        return plateaus


@dataclass(frozen=True)
class TourStep:
    """Step of the tour.

    Attributes:
        title, task: Texts for the user.
        sheet: Terms that data sheets use for it.
        done: Function that returns whether the user has done the step.
        shown_by: Part of the page that shows what happens: scene, readout, scope or procedures.
        form: Form that performs the step.
        texts: Texts for fields of the form, by name.
    """

    title: str
    task: str
    sheet: str
    done: Callable[[Tour], bool]
    shown_by: str
    form: str
    texts: Mapping[str, str]


class Tour:
    """Tour that observes a session until the last step is done, or until `close`.

    Attributes:
        number: Number of the present step, from 0; len(STEPS) when all are done.
        finished: Name of the axis and motion, for the last motions that have ended since the step began.
        lost: Whether an axis has lost steps since the step began.
    """

    def __init__(self, session: Session):
        self.number = 0
        self.finished: list[tuple[str, AxisMotion]] = []
        self.lost = False
        self._running_axes: dict[str, AxisMotion] = {}
        self._pulses: dict[str, tuple[float, float]] = {}  # net pulses of each axis, and when, s
        self._lost_at_first: dict[str, int] = {}
        self._end_observing = session.call_after_pacing_intervals(self.observe)

    @property
    def step(self) -> TourStep | None:
        """Present step; None when all are done."""
        return STEPS[self.number] if self.number < len(STEPS) else None

    def skip(self) -> None:
        """Go on to the next step."""
        self.number = min(self.number + 1, len(STEPS))
        self._forget_runs()

    def close(self) -> None:
        """Stop observing."""
        self._end_observing()

    def observe(self, stage: Stage) -> None:
        """Observe the stage after a slice. The stage's thread calls this."""
        for axis in stage.axes.values():
            self._sample_axis_motion(axis, stage.time)
        step = self.step
        if step is not None and step.done(self):
            self.skip()

    def has_pulses(self) -> bool:
        """Return whether an axis moves, or has moved since the step began."""
        return bool(self.finished or self._running_axes)

    def _forget_runs(self) -> None:
        self.finished, self.lost = [], False
        self._lost_at_first.clear()
        for run in self._running_axes.values():
            run.began_before_step = True

    def _sample_axis_motion(self, axis: Axis, now: float) -> None:
        """Sample the pulses and lost steps of an axis at the time `now`, s, if SAMPLE_TIME_S has passed since the last sample."""
        _, net = axis.read_drive()
        before, then = self._pulses.get(axis.name, (net, now))
        lost = axis.lost_steps
        self.lost |= lost != self._lost_at_first.setdefault(axis.name, lost)
        if now < then:  # somebody went back in time
            self._running_axes.pop(axis.name, None)
        elif now - then < SAMPLE_TIME_S:
            self._pulses.setdefault(axis.name, (net, now))
            return
        else:
            self._add_rate(axis, abs(net - before) / (now - then), then, now)
        self._pulses[axis.name] = net, now

    def _add_rate(self, axis: Axis, rate: float, then: float, now: float) -> None:
        """Add a sample of the rate, pps, between the times `then` and `now`, s, to the motion of an axis.

        A motion begins with its first pulse, and ends when no pulse has come for QUIET_TIME_S.
        """
        run = self._running_axes.get(axis.name)
        if run is None:
            if not rate:
                return
            run = self._running_axes[axis.name] = AxisMotion(begin=then)
        run.saw_org |= bool(axis.switches.as_dict().get("org"))
        if rate:
            run.rates.append(rate)
            del run.rates[:-MAX_RATES]
            run.end = now
        elif now - run.end >= QUIET_TIME_S:
            del self._running_axes[axis.name]
            if not run.began_before_step:
                self.finished.append((axis.name, run))
                del self.finished[:-MAX_RUNS]


def _has_ramp(tour: Tour) -> bool:
    """Return whether a motion began with a lower rate than it reached later, and was slower again before its end."""
    runs = [run.rates for _, run in tour.finished]
    return any(len(rates) >= 3 and max(rates[0], rates[-1]) < 0.8 * max(rates) for rates in runs)


def _has_two_rates(tour: Tour) -> bool:
    """Return whether a motion went from one constant rate up to another; an origin return only goes down."""
    return any(a < b for _, run in tour.finished for a, b in pairwise(run.list_plateaus()))


def _is_synchronized(tour: Tour) -> bool:
    """Return whether two axes moved at the same time and ended together."""
    return any(
        a != b and abs(d.end - e.end) <= SIMULTANEITY_S and min(d.end, e.end) > max(d.begin, e.begin)
        for (a, d), (b, e) in pairwise(tour.finished)
    )


STEPS = (
    TourStep(
        "First pulse",
        "The form asks for a move of 1 mm. Press go. (With bytes: the front panel of the chip, further down.)",
        "Preset or positioning operation: the chip gives out as many pulses as its pulse register says, and each pulse turns the "
        "motor by one microstep.",
        Tour.has_pulses,
        "procedures",
        "move",
        {"distance": "1"},
    ),
    TourStep(
        "Ramp",
        "Now 40 mm: press go, and look here at the pulse rate. It rises, stays, and falls again.",
        "High-speed operation with ramp-up and ramp-down, from the initial speed (FL, SV) to the drive speed (FH, V) at an "
        "acceleration rate.",
        _has_ramp,
        "scope",
        "move",
        {"distance": "40"},
    ),
    TourStep(
        "Stall",
        "The form now asks for more than the motor can: 600 mm/s after a ramp of 0.02 s. Press go. The pulses go on and the "
        "carriage does not: here you see the lost steps. The chip cannot know.",
        "Pull-out torque: beyond it a stepper loses synchronism, by four full steps at a time. Data sheets of motors have a curve.",
        lambda tour: tour.lost,
        "readout",
        "move",
        {"distance": "-40", "speed": "600", "start_speed": "300", "accel": "0.02"},
    ),
    TourStep(
        "Origin return",
        "After lost steps nobody knows where the carriage is. Press go: it drives to its origin switch.",
        "Origin return, home position search: the chip drives until the ORG (home, STOP) input becomes active.",
        lambda tour: any(run.saw_org for _, run in tour.finished),
        "scene",
        "home",
        {},
    ),
    TourStep(
        "Dual rate",
        "One move at two speeds: press go, and look at the pulse rate.",
        "FH1 and FH2, or a drive speed that is written while driving: the chip ramps from the one to the other.",
        _has_two_rates,
        "scope",
        "two_rates",
        {"distance": "60"},
    ),
    TourStep(
        "Synchronized move",
        "Two axes that begin and end together, 30 mm by 10 mm: press go.",
        "Linear interpolation, or two chips with rates as a : b, started by one command (CSTA, STA, one write to both).",
        _is_synchronized,
        "scene",
        "line",
        {"x": "30", "y": "10"},
    ),
)
