"""`Trial`: what a customer wants of a machine with its program, in numbers; and the watch that finds out whether it does so.

The program is run from power-up. The carriage has to rest at the places that are wanted, one after the other, on time and at the
speed that was asked for; who crawls there, stops short of it, loses steps or runs against an end has not delivered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from registerbench.diagnosis.host_program import SAMPLE_INTERVAL_S
from stage import Stage
from stage.errors import RunTimeout

WITHIN = 60e-6  # m, of the place that is wanted: a full step and what friction holds
ASIDE = 30e-6  # m, by which an axis that has nothing to do may be shaken
REST = 0.1  # s at each place
FASTER, SLOWER = 1.05, 0.95  # of the rate that is wanted
WINDOW = 5  # samples over which a rate is measured
REACHED = 0.95  # of the rate of a leg: its ramp ends there


class Sample(NamedTuple):
    """State at a time: what was commanded and where x is, m; lost steps; travel of the other axis, m."""

    time: float
    commanded: float
    x: float
    lost: float
    aside: float
    busy: bool


@dataclass(frozen=True)
class Trial:
    """Requirements of the customer on a run.

    Attributes:
        stops: Where x rests, one after the other, m.
        from_start: They are seen from where x begins.
        rate: At the top of each leg, pps.
        seconds: For all.
        ramp: Seconds that the first leg takes at least to reach its rate.
        starts: Where x is put at power-up, a run for each.
        within: m.
    """

    stops: tuple[float, ...]
    rate: float
    seconds: float
    ramp: float = 0.0
    starts: tuple[float, ...] = (0.0,)
    from_start: bool = True
    within: float = WITHIN

    def __str__(self) -> str:
        places = ", ".join(f"{1e3 * s:g}" for s in self.stops)
        samples = "from where it begins" if self.from_start else "from the middle of its travel"
        ramp = f", with ramps up of {self.ramp:g} s or more on the way to the first" if self.ramp else ""
        return (
            f"x comes to {places} mm {samples}, and rests {REST:g} s at each; within {1e3 * self.within:g} mm, "
            f"at {self.rate:g} pulses a second{ramp}, all in {self.seconds:g} s from power-up; y stands still, and no step "
            "may be lost"
        )

    def wrong(self, samples: list[Sample], start: float, per_pulse: float) -> str:
        """Return why a run is not what the customer wants, or "".

        Args:
            samples: Of the run.
            start: Where x began, m.
            per_pulse: m.
        """
        rests = rests_of(samples)
        wanted = [s + start * self.from_start for s in self.stops]
        found = [samples[last].x for _, last in rests]
        if len(found) != len(wanted):
            return f"it rests at {len(found)} places, and {len(wanted)} are wanted"
        for place, goal in zip(found, wanted, strict=True):
            if abs(place - goal) > self.within:
                return f"it rests at {1e3 * place:.3f} mm, and {1e3 * goal:g} mm is wanted"
        if any(round(abs(samples[last].lost)) for _, last in rests):
            return "steps are lost"
        if max(abs(s.aside) for s in samples) > ASIDE:
            return "y moves"
        return self._wrong_way(samples, rests, per_pulse)

    def _wrong_way(self, samples: list[Sample], rests: list[tuple[int, int]], per_pulse: float) -> str:
        """Return what is wrong with the rates and ramps between the stops, or ""."""
        begins = 0
        for k, (first, last) in enumerate(rests):
            times = np.array([s.time for s in samples[begins : first + 1]])
            places = np.array([s.commanded for s in samples[begins : first + 1]])
            if len(times) <= WINDOW:
                return "a way is too short to have a rate"
            rates = np.abs((places[WINDOW:] - places[:-WINDOW]) / (times[WINDOW:] - times[:-WINDOW])) / per_pulse
            top = float(rates.max())
            if not SLOWER * self.rate <= top <= FASTER * self.rate:
                return f"way {k + 1} has {top:.0f} pulses a second"
            up = times[int(np.argmax(rates >= REACHED * top))] - times[int(np.argmax(rates > 0))]
            if k == 0 and up < REACHED * self.ramp - 2 * WINDOW * SAMPLE_INTERVAL_S:
                return f"its ramp up takes {up:.3f} s"
            begins = last
        return ""


class Watch:
    """Looks at a stage while a program runs; its `look` raises RunTimeout when more than `seconds` have passed."""

    def __init__(self, stage: Stage, seconds: float):
        self._stage, self._seconds = stage, seconds
        self.samples: list[Sample] = []
        self.sample()

    def sample(self) -> None:
        """Note what is so, every few milliseconds."""
        now = self._stage.time
        if self.samples and now - self.samples[-1].time < 0.9 * SAMPLE_INTERVAL_S:
            return
        if now > self._seconds:
            raise RunTimeout(f"it takes more than {self._seconds:g} s.")
        x, y = self._stage.axes["x"], self._stage.axes["y"]
        busy = x.chip.busy(x.chip_axis) or y.chip.busy(y.chip_axis)
        self.samples.append(Sample(now, x.commanded, x.position, x.lost_steps, y.position, busy))


def rests_of(samples: list[Sample]) -> list[tuple[int, int]]:
    """The first and last sample of each rest of REST or more, after x was told to move."""
    rests: list[tuple[int, int]] = []
    first, gone = None, False
    for k, s in enumerate([*samples, samples[-1]._replace(busy=True)]):
        if s.busy:
            if gone and first is not None and samples[k - 1].time - samples[first].time >= REST:
                rests.append((first, k - 1))
                gone = False
            first = None
        else:
            gone = gone or s.commanded != samples[rests[-1][1] if rests else 0].commanded
            first = k if first is None else first
    return rests
